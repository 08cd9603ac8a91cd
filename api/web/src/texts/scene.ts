import { plural } from "./figures";

/** The list of scenes, and the page of one. */
export const sceneTexts = {
  scenes: {
    title: "Scenes",
    empty: "No scenes yet.",
    emptyHint: "Upload photos, a video or a splat, and a scene is made of them. Or look at one that is ready:",
    openSample: "Open the sample scene",
    select: "Select",
    selectDone: "Done",
    selectOne: (name: string) => `Select ${name}`,
    removeSelected: (count: number) => `Delete ${plural(count, "scene", "scenes")}`,
    removeQuestion: (names: readonly string[]) =>
      `Delete ${names.map((name) => `“${name}”`).join(", ")}? Their versions and files are removed for good.`,
    untitled: "Untitled scene",
    gaussians: (count: number) => plural(count, "Gaussian", "Gaussians"),
    objects: (count: number | null, names: readonly string[]) =>
      [count === null ? "" : plural(count, "object", "objects"), names.slice(0, 12).join(", ")]
        .filter(Boolean)
        .join(": "),
    grades: { good: "Ready", fair: "Ready, fair", poor: "Ready, poor" },
    find: "Find a scene, or ask where something is",
    findExample: "A name, or: where is the drill?",
    askAll: "Ask all scenes",
    sort: "Sort by",
    orders: { newest: "Newest first", name: "By name", largest: "Largest first" },
    noneNamed: (text: string) => `No scene is called “${text}”. “Ask all scenes” looks for it among the objects.`,
    foundIn: (text: string, found: number, all: number) =>
      `“${text}”: in ${found} of ${plural(all, "scene", "scenes")}`,
    states: { TRAINING: "In progress", READY: "Ready", FAILED: "Failed", CANCELLED: "Cancelled" },
    pictureOf: (name: string) => `Picture of ${name}`,
  },
  scene: {
    back: "All scenes",
    unavailable: "This scene cannot be shown",
    loading3d: (percent: number) => `Loading the scene: ${percent} %`,
    canvas: "3D view of the scene",
    canvasHelp:
      "Drag to orbit, drag with the right button or two fingers to move, wheel or pinch to zoom. Keys: arrows orbit, Shift and arrows turn, W A S D move, E and Q rise and sink, plus and minus zoom, Home goes back to the first view.",
    walkHelp:
      "A click selects an object. By keyboard, Enter begins to walk from object to object: arrows walk, Enter selects, Escape leaves. Anywhere, / asks and Ctrl+Z undoes.",
    tools: "Tools",
    panel: "About this scene",
    tabs: { ask: "Ask", objects: "Objects", photos: "Photos", share: "Share" },
    unseen: "No photo shows what is here.",
    backToSeen: "Back to the first view",
    walkBegins: "Arrows walk from object to object, Enter selects, Escape leaves.",
    help: "How to move",
    home: "First view",
    registered: (used: unknown, all: unknown) => `${String(used)} of ${String(all)} photos placed`,
    psnr: (value: number) => `${value.toFixed(1)} dB PSNR`,
    doubling: (gain: number) =>
      gain < 0.05 ? "more training would add nothing" : `twice the training would add about ${gain.toFixed(1)} dB`,
    remove: "Delete scene",
    removeQuestion: (name: string) => `Delete “${name}”? Its versions and files are removed for good.`,
    removeYes: "Delete for good",
    oldVersion: "This is an older version.",
    toCurrent: "Show the current one",
    changedElsewhere: "The scene has changed.",
  },
  sceneName: { edit: "Rename", label: "Name of the scene", save: "Save" },
  assessment: {
    title: "How good this scene is",
    grades: {
      good: "A good scene.",
      fair: "A fair scene: look before you rely on it.",
      poor: "A poor scene: it should be made anew.",
    },
  },
  serverView: {
    note: "This browser has no WebGL 2, so the server draws the scene, picture by picture.",
  },
  photos: {
    title: "Photos",
    placed: (placed: number, all: number) => `${placed} of ${plural(all, "photo", "photos")} placed.`,
    fine: "Nothing is wrong with any of them.",
    troubled: (count: number) => `${plural(count, "photo needs", "photos need")} a look.`,
    showAll: "Show all photos",
    beside: (name: string) => `Nearest: ${name}`,
    notAssessed: "What became of its photos was not recorded.",
    isPlaced: "Placed",
    notPlaced: {
      few_features: "Not placed: hardly any texture",
      no_overlap: "Not placed: no overlap with others",
      few_matches: "Not placed: too few matches",
      other_model: "Not placed: belongs to another group",
      masked: "Not placed: masked entirely",
      unknown: "Not placed",
      lens: "Not placed: its lens could not be worked out",
      unreadable: "Not placed: the file is damaged",
    },
    defects: { blurred: "Blurred", dark: "Dark", duplicate: "Duplicate" },
  },
  privacy: {
    people: "Keep people out",
    hint: "Whoever the detector finds in the photos is blanked before anything is made of them. The files as sent are deleted.",
    withheld: (people: boolean, photos: number, share: number) =>
      `${people ? "People are" : "What moves is"} left out of ${plural(photos, "photo", "photos")}: ${(100 * share).toFixed(1)} % of all pixels.`,
    ofPhoto: (share: number) => `${(100 * share).toFixed(1)} % withheld`,
  },
};
