import { expect, test } from "vitest";

/** The folders from the ground up. A file imports from its own folder and from lower layers alone, types included. */
const LAYERS: readonly (readonly string[])[] = [
  ["address", "styles", "texts"],
  ["api"],
  ["ui", "viewer"],
  ["state"],
  ["jobs", "look"],
  ["ask", "change", "improve", "photos", "serverView", "take", "objects"],
  ["offline", "scene", "scenes", "server", "upload"],
  ["app"],
  ["."],
];

const files = import.meta.glob<string>(["./**/*.{ts,tsx,css}", "!./api/schema.d.ts"], {
  query: "?raw",
  import: "default",
  eager: true,
});

/** For each source file those that it imports, as `./folder/file.ts`. */
const imports = new Map(
  Object.entries(files).map(([path, source]) => [
    path,
    [...source.matchAll(/(?:\bfrom|\bimport|\bimport\()\s*"(\.[^"]*)"/g)].map(([, name = ""]) => fileOf(path, name)),
  ]),
);

function fileOf(from: string, name: string): string {
  const path = `.${new URL(name, `file:///${from}`).pathname}`;
  return [path, `${path}.ts`, `${path}.tsx`, `${path}/index.ts`].find((file) => file in files) ?? path;
}

const folderOf = (path: string): string => /^\.\/([^/]+)\//.exec(path)?.[1] ?? ".";
const layerOf = (path: string): number => LAYERS.findIndex((layer) => layer.includes(folderOf(path)));

test("every import leads to a file, and every folder has a layer", () => {
  const elsewhere = new Set([...imports.values()].flat().filter((path) => !(path in files)));
  expect([...elsewhere]).toEqual(["./api/schema"]); // is generated
  expect(Object.keys(files).filter((path) => layerOf(path) < 0)).toEqual([]);
});

test("no folder imports from its own layer or from one above", () => {
  const upward = [...imports].flatMap(([path, others]) =>
    others
      .filter((other) => folderOf(other) !== folderOf(path) && layerOf(other) >= layerOf(path))
      .map((other) => `${path} -> ${other}`),
  );
  expect(upward).toEqual([]);
});

test("no file imports itself through others", () => {
  const done = new Set<string>();
  const circles: string[] = [];
  const follow = (path: string, way: readonly string[]): void => {
    if (way.includes(path)) circles.push([...way.slice(way.indexOf(path)), path].join(" -> "));
    else if (!done.has(path)) for (const other of imports.get(path) ?? []) follow(other, [...way, path]);
    done.add(path);
  };
  for (const path of imports.keys()) follow(path, []);
  expect(circles).toEqual([]);
});
