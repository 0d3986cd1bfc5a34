// Controls of a saved page: layers, lines, arrows and runs are nodes of viser's scene tree, whose
// context and playback are reached through the properties that React stores in the elements.
(() => {
  function search(element, wanted) {
    const key = element && Object.keys(element).find(each => each.startsWith("__reactFiber$"));
    for (let fiber = key && element[key]; fiber; fiber = fiber.return) {
      const found = wanted(fiber.memoizedProps);
      if (found) return found;
    }
    return null;
  }
  const viewer = () => search(document.querySelector("canvas"),
    props => props?.value?.sceneTreeActions && props.value);
  const playback = () => search(document.querySelector(".mantine-Slider-root"),
    props => props?.max > 0 && props.onChange && props);
  function show(node, visible) {
    viewer()?.sceneTreeActions.updateNodeAttributes(
      node, {overrideVisibility: visible === false ? false : visible === "on" ? true : undefined});
  }
  const box = document.getElementById("slipfree");
  box.addEventListener("change", event => {
    const {nodes} = event.target.dataset, split = text => text.split("|").filter(Boolean);
    if (nodes) for (const node of split(nodes)) show(node, event.target.checked);
    for (const option of event.target.options ?? []) {
      for (const node of split(option.dataset.nodes)) show(node, option.selected ? "on" : false);
      document.getElementById(option.value).hidden = !option.selected;
    }
  });
  box.querySelector("button")?.addEventListener("click", ({target}) => {
    const {cameraControl: camera, requestRender} = viewer().mutable.current;
    target.dataset.near ??= camera.distance;
    const near = Number(target.dataset.near), isNear = camera.distance < 2 * near;
    const distance = isNear ? 1.5 * Number(target.dataset.size) : near, lens = camera.camera;
    camera.maxDistance = Infinity;
    lens.near *= distance / camera.distance;  // else lines sink into ground that is far away
    lens.updateProjectionMatrix();
    camera.dollyTo(distance, false);
    for (const node of target.dataset.nodes.split("|")) show(node, isNear ? "on" : false);
    target.textContent = isNear ? "vehicle" : "overview";
    requestRender();
  });
  const plots = [...document.querySelectorAll("#plots svg")];
  const time = () => document.querySelector(".mantine-Slider-root input")?.value;
  for (const plot of plots) plot.addEventListener("click", event => {
    const now = playback();
    now?.onChange(event.offsetX / plot.clientWidth * now.max * 0.9999);
  });
  const clock = document.querySelector("#plots > div:last-child b");
  function follow(before) {  // clock, cursors and values of the plots
    const t = time(), max = t !== before && playback()?.max;
    const {first, last} = clock.parentElement.dataset;
    if (max) for (const plot of plots) {
      const lines = plot.querySelectorAll("polyline"), count = lines[0].points.length;
      const k = Math.min(Math.floor(t / max * count), count - 1);
      clock.textContent = `${(+first + (last - first) * k / (count - 1)).toFixed(2)} s`;
      plot.querySelector("line").setAttribute("transform", `translate(${k})`);
      const digits = Math.max(0, 2 - Math.floor(Math.log10(plot.viewBox.baseVal.height)));
      plot.previousElementSibling.querySelectorAll("b").forEach((value, n) => {
        value.textContent = lines[n].points[k].y.toFixed(digits);
      });
      for (const line of document.querySelectorAll("#map polyline")) {
        const {x, y} = line.points[k];
        line.nextElementSibling.setAttribute("transform", `translate(${x} ${y})`);
      }
    }
    requestAnimationFrame(() => follow(max ? t : before));
  }
  if (plots.length) follow();
  addEventListener("keydown", event => {
    if (["INPUT", "SELECT"].includes(event.target.tagName)) return;
    const now = playback();
    if (!now) return;
    const step = {ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1}[event.key];
    if (step) now.onChange(Math.min(Math.max(+time() + step * now.max, 0), now.max * 0.9999));
  }, true);
})();
