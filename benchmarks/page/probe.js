// Runs in the page before its own scripts: when the scene was first drawn, when Enter was pressed and the answer drawn,
// and how many frames were drawn. A frame is an animation frame in which WebGL was asked to draw, or a picture that the
// server has drawn.
window.probe = { frames: 0, shown: 0, entered: 0, glowing: 0 };
let drawn = false;
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
  const original = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...values) {
    drawn = true;
    return original.apply(this, values);
  };
}
let pictures = "";
const watch = () => {
  const canvas = document.querySelector("canvas");
  const count = canvas?.dataset.pictures ?? "";
  if (count !== pictures) drawn = true;
  pictures = count;
  if (drawn) {
    window.probe.frames += 1;
    const shown = canvas?.dataset.shown ?? "";
    if (shown && !window.probe.shown) window.probe.shown = performance.now();
    if (shown.endsWith("answer") && window.probe.entered && !window.probe.glowing) window.probe.glowing = performance.now();
  }
  drawn = false;
  requestAnimationFrame(watch);
};
requestAnimationFrame(watch);
document.addEventListener(
  "keydown",
  (event) => {
    if (event.key === "Enter") Object.assign(window.probe, { entered: performance.now(), glowing: 0 });
  },
  true,
);
