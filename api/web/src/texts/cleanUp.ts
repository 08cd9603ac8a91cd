import { plural } from "./figures";

/** Cleaning a scene up, and cropping it. */
export const cleanUpTexts = {
  cleanUp: {
    title: "Clean up and crop",
    faint: "Remove what is faint",
    stray: "Remove what floats alone",
    off: "off",
    below: (opacity: number) => `opacity below ${opacity.toFixed(2)}`,
    farther: (times: number) => `${times} times as far from others as usual`,
    box: "Crop by a box",
    side: "Keep what is",
    keepInside: "inside the box",
    keepOutside: "outside the box",
    sides: ["Left", "Right", "Front", "Back", "Bottom", "Top"],
    brush: "Brush over objects",
    brushHelp: (count: number) =>
      `Draw over what is to go; the view stands still meanwhile. ${plural(count, "object", "objects")} marked.`,
    goes: (count: number, all: number) =>
      `${count.toLocaleString("en")} of ${plural(all, "Gaussian", "Gaussians")} would go; they are not shown.`,
    all: "Nothing would stay.",
    apply: "Remove them",
    done: "Cleaned up.",
  },
};
