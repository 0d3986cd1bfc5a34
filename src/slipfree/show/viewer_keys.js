// viser turns the camera with the arrow keys, which control the time here: its listener is on the
// document, those of hotkeys are on the root element.
document.documentElement.addEventListener("keydown", event => {
  if (event.key.startsWith("Arrow")) event.stopPropagation();
});
