import { expect, test } from "vitest";

import type { ChosenFile } from "./choose";
import { joined, problemOf, remarkOn, sorted } from "./choose";

const file = (path: string, size = 10): ChosenFile => ({ file: { size } as File, path });
const paths = (files: ChosenFile[]) => files.map(({ path }) => path);

test("photos, archives and videos are taken, the rest is named", () => {
  const { taken, refused } = sorted(
    ["a.JPG", "b.png", "c.heic", "d.docx", "e.zip", "f.r3d", ".DS_Store"].map((each) => file(each)),
  );
  expect(paths(taken)).toEqual(["a.JPG", "b.png", "c.heic", "e.zip", "f.r3d"]);
  expect(refused).toHaveLength(1);
  expect(refused[0]).toContain("d.docx");
});

test("a folder may bring poses and label maps", () => {
  const { taken, refused } = sorted(
    ["room/images/1.jpg", "room/transforms.json", "room/metadata", "room/rgbd/1.depth", "room/.git/x.json"].map(
      (each) => file(each),
    ),
  );
  expect(paths(taken)).toEqual(["room/images/1.jpg", "room/transforms.json", "room/metadata", "room/rgbd/1.depth"]);
  expect(refused).toEqual([]);
});

test("an empty file is refused", () => {
  expect(sorted([file("a.jpg", 0)]).refused[0]).toContain("a.jpg");
});

test("what cannot become one scene is said before it is sent", () => {
  expect(problemOf([file("a.zip"), file("b.jpg")], null)).not.toBe("");
  expect(problemOf([file("a.zip")], null)).toBe("");
  const limits = { maxBytes: 1000, bytesLeft: 800, maxImages: 2 };
  expect(problemOf([file("a.jpg", 600), file("b.jpg", 600)], limits)).toContain("1.0 kB");
  expect(problemOf([file("a.jpg", 900)], limits)).toContain("800 B left");
  expect(problemOf([file("a.jpg", 900)], { ...limits, bytesLeft: null })).toBe("");
  expect(problemOf([file("a.jpg", 600)], limits)).toBe("");
  const many = Array.from({ length: 5 }, (_, number) => file(`${number}.jpg`, 1));
  expect(problemOf(many, limits)).toContain("5 images");
});

test("few photos are remarked on, photos with poses and archives are not", () => {
  const photos = Array.from({ length: 20 }, (_, number) => file(`${number}.jpg`));
  expect(remarkOn(photos)).toBe("");
  expect(remarkOn(photos.slice(0, 19))).toContain("19 photos");
  expect(remarkOn(photos.slice(0, 1))).toContain("1 photo ");
  expect(remarkOn([...photos.slice(0, 5), file("transforms.json")])).toBe("");
  expect(remarkOn([file("a.zip")])).toBe("");
});

test("a file that is chosen again is there once, and another one of its name gets a number", () => {
  const again = joined([file("a.jpg"), file("b.jpg")], [file("a.jpg"), file("c.jpg")]);
  expect(paths(again)).toEqual(["b.jpg", "a.jpg", "c.jpg"]);
  const taken = [1, 2, 3].reduce<ChosenFile[]>((before, size) => joined(before, [file("image.jpg", size)]), []);
  expect(taken.map(({ path, file }) => [path, file.size])).toEqual([
    ["image.jpg", 1],
    ["image-2.jpg", 2],
    ["image-3.jpg", 3],
  ]);
  expect(paths(joined([file("d/metadata", 1)], [file("d/metadata", 2)]))).toEqual(["d/metadata", "d/metadata-2"]);
});
