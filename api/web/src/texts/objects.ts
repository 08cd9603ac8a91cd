import { percent, plural } from "./figures";

const numbered = (id: number, what = "") => `${what ? what.charAt(0).toUpperCase() + what.slice(1) : "Object"} ${id}`;

const unnamed = (id: number, what = "") => `${numbered(id, what)}, no name`;

interface Named {
  id: number;
  name: string;
  guess?: boolean;
  probability?: number;
  surface?: string;
}

const suggestion = (name: string, probability: number, sources: string[]) =>
  `${name} (${percent(probability)}${sources.map((source) => `, says ${source}`).join("")})`;

const titleOf = ({ name, id, guess, probability = 0, surface = "" }: Named) =>
  guess ? `${name} (a guess, ${percent(probability)})` : name || unnamed(id, surface);

/** Questions and objects. */
function countOf(objects: number, surfaces: number): string {
  const counted = [
    ...(objects ? [plural(objects, "object", "objects")] : []),
    ...(surfaces ? [plural(surfaces, "surface", "surfaces")] : []),
  ];
  return counted.join(" and ");
}

export const objectsTexts = {
  ask: {
    title: "Ask",
    label: "What are you looking for?",
    placeholder: "Where is the mug?",
    others: "It may also be",
    otherNames: "Other names here",
    select: "Select it",
    near: (label: string) => `What is near the ${label}?`,
    confirm: (label: string) => `Yes, it is “${label}”`,
    seeObjects: "See all objects",
    lookAt: (name: string) => `Look at ${name}`,
    askFor: (label: string) => `Ask for ${label}`,
    objects: "Where",
    flyTo: (label: string, number: number) => `Look at ${label} ${number}`,
    knownLabels: "This scene knows",
  },
  objects: {
    title: "Objects",
    none: "No objects were found in this scene.",
    numbered,
    unnamed,
    /** The name of an object, and whether that is a guess; or what stands for it. */
    titleOf,
    /** Which level of what is at a place is selected; `members` is the number of objects of its group. */
    level: (level: "part" | "object" | "group", object: Named, part: Named | null, members: number) => {
      if (level === "part") return `${part?.name ? `${part.name}, ` : ""}part of ${titleOf(object)}`;
      return level === "object" ? titleOf(object) : `group: ${titleOf(object)} and ${members - 1} more`;
    },
    clickAgain: (selected: string, next: string) => `Selected: ${selected}. Click again for ${next}.`,
    counted: (objects: number, surfaces: number) => `${countOf(objects, surfaces)}.`,
    unnamedCount: (objects: number, surfaces: number) =>
      objects + surfaces ? `${countOf(objects, surfaces)} without a name` : "All objects have names.",
    nameNext: "Name the next one",
    onlyUnnamed: "Only those without a name",
    selected: (count: number) => plural(count, "object selected", "objects selected"),
    nothingThere: "There is no object at this place.",
    name: "Name",
    save: "Save the name",
    aliases: "Other names, separated by commas",
    alsoCalled: (aliases: readonly string[]) => `Also called ${aliases.join(", ")}.`,
    isA: (name: string) => `${name} is a …`,
    kindExample: "teddy bear, toy",
    saveKind: "Save what it is",
    skipKind: "Do not say",
    sources: { given: "named by the capture", detected: "named by a detector", person: "named by a person" },
    probability: (value: number) => `${percent(value)} sure`,
    suggestions: "It may be",
    says: (lines: readonly string[]) => `It says ${lines.map((line) => `“${line}”`).join(", ")}`,
    suggestion,
    suggested: (...told: Parameters<typeof suggestion>) =>
      `Suggested: ${suggestion(...told)}. Enter takes it; clear the field to leave the object without a name.`,
    confirmLikely: (count: number) => `Take ${plural(count, "name", "names")} of 80 % and more`,
    confirmed: (count: number) => `${plural(count, "name", "names")} taken.`,
    sizeOf: (sides: number[], meters: boolean) =>
      `${sides.map((side) => side.toFixed(2)).join(" × ")} ${meters ? "m" : "scene units"}`,
    lookAt: "Look at it",
    merge: "Merge into one",
    mergeHelp: "Hold Shift while clicking, or tick further objects in the list, to merge several into one.",
    discard: "Discard",
    unname: "Remove the name",
    close: "Close",
    undo: "Undo",
    undone: "Undone.",
    saved: (name: string) => `Named “${name}”.`,
    merged: "Merged.",
    discarded: "Discarded.",
    unnamedNow: "The name is gone.",
    tick: (name: string) => `Select ${name}`,
  },
};
