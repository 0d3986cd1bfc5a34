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
    const {node, layer} = event.target.dataset;
    if (node) for (const each of node.split("|")) show(each, event.target.checked);
    if (layer !== undefined) for (const option of event.target.options) {
      const chosen = option.selected;
      show(option.dataset.ground, chosen ? "on" : false);
      document.getElementById(option.value).hidden = !chosen;
    }
  });
  addEventListener("keydown", event => {
    if (["INPUT", "SELECT"].includes(event.target.tagName)) return;
    const now = playback();
    if (!now) return;
    const step = {ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1}[event.key];
    const t = Number(document.querySelector(".mantine-Slider-root input").value);
    if (step) now.onChange(Math.min(Math.max(t + step * now.max, 0), now.max * 0.9999));
  }, true);
})();
