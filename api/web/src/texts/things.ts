import { percent, plural } from "./figures";

const unnamed = (id: number, what = "") =>
  `${what ? what.charAt(0).toUpperCase() + what.slice(1) : "Thing"} ${id}, no name`;

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

/** Questions and things. */
function countOf(things: number, surfaces: number): string {
  const counted = [
    ...(things ? [plural(things, "thing", "things")] : []),
    ...(surfaces ? [plural(surfaces, "surface", "surfaces")] : []),
  ];
  return counted.join(" and ");
}

export const thingsTexts = {
  ask: {
    title: "Ask",
    label: "What are you looking for?",
    placeholder: "Where is the mug?",
    others: "It may also be",
    otherNames: "Other names here",
    select: "Select it",
    near: (label: string) => `What is near the ${label}?`,
    confirm: (label: string) => `Yes, it is “${label}”`,
    seeThings: "See all things",
    lookAt: (name: string) => `Look at ${name}`,
    askFor: (label: string) => `Ask for ${label}`,
    objects: "Where",
    flyTo: (label: string, number: number) => `Look at ${label} ${number}`,
    knownLabels: "This scene knows",
  },
  things: {
    title: "Things",
    none: "No things were found in this scene.",
    unnamed,
    /** The name of a thing, and whether that is a guess; or what stands for it. */
    titleOf,
    /** Which level of what is at a place is selected; `members` is the number of things of its group. */
    level: (level: "part" | "thing" | "group", thing: Named, part: Named | null, members: number) => {
      if (level === "part") return `${part?.name ? `${part.name}, ` : ""}part of ${titleOf(thing)}`;
      return level === "thing" ? titleOf(thing) : `group: ${titleOf(thing)} and ${members - 1} more`;
    },
    clickAgain: (selected: string, next: string) => `Selected: ${selected}. Click again for ${next}.`,
    counted: (things: number, surfaces: number) => `${countOf(things, surfaces)}.`,
    unnamedCount: (things: number, surfaces: number) =>
      things + surfaces ? `${countOf(things, surfaces)} without a name` : "All things have names.",
    nameNext: "Name the next one",
    onlyUnnamed: "Only those without a name",
    selected: (count: number) => plural(count, "thing selected", "things selected"),
    nothingThere: "There is no thing at this place.",
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
      `Suggested: ${suggestion(...told)}. Enter takes it; clear the field to leave the thing without a name.`,
    confirmLikely: (count: number) => `Take ${plural(count, "name", "names")} of 80 % and more`,
    confirmed: (count: number) => `${plural(count, "name", "names")} taken.`,
    sizeOf: (sides: number[], meters: boolean) =>
      `${sides.map((side) => side.toFixed(2)).join(" × ")} ${meters ? "m" : "scene units"}`,
    lookAt: "Look at it",
    merge: "Merge into one",
    mergeHelp: "Hold Shift while clicking, or tick further things in the list, to merge several into one.",
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
