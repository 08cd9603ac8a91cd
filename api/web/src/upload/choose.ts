import { texts } from "../texts";
import { bytesText } from "../texts/figures";
import type { Limits } from "./limits";

/** A file and the name under which it is sent: with the folders it was chosen in. */
export interface ChosenFile {
  file: File;
  path: string;
}

const PHOTOS = /\.(jpe?g|png|webp|bmp|tiff?|heic|heif)$/i;
const FEW_PHOTOS = 20;
const WHOLE = /\.(zip|r3d|tar|tgz|tar\.gz|mp4|mov|m4v|avi|mkv|webm|ply|spz|sog|k?splat)$/i;
const SPLAT = /\.(ply|spz|sog|k?splat)$/i;
// Poses, depth maps, label maps and models in a capture's folder; Record3D's metadata has no suffix.
const BESIDE = /(\.(json|txt|bin|ply|spz|npy|depth|conf)|(^|\/)metadata)$/i;

/** Whether a file is a photo, by its name. */
export function isPhoto(path: string): boolean {
  return PHOTOS.test(path);
}

/** What can be sent of these files, and why the rest cannot. Hidden files of a folder are left out without a word. */
export function sorted(files: readonly ChosenFile[]): { taken: ChosenFile[]; refused: string[] } {
  const taken: ChosenFile[] = [];
  const refused: string[] = [];
  const visible = files.filter(({ path }) => !path.split("/").some((part) => part.startsWith(".")));
  const folder = visible.some(({ path }) => path.includes("/"));
  for (const each of visible) {
    if (!isPhoto(each.path) && !WHOLE.test(each.path) && !(folder && BESIDE.test(each.path)))
      refused.push(texts.upload.kind(each.path));
    else if (each.file.size === 0) refused.push(texts.upload.empty(each.path));
    else taken.push(each);
  }
  return { taken, refused };
}

/** The files with more of them: one that is chosen again is there once, another one of that name gets a number. */
export function joined(before: readonly ChosenFile[], more: readonly ChosenFile[]): ChosenFile[] {
  const all = new Map(before.map((each) => [each.path, each]));
  for (const { file, path } of more) {
    let name = path;
    // Phones call every photo that is taken on a page "image.jpg".
    for (let number = 2; all.has(name) && !isSame(all.get(name)?.file, file); number++)
      name = path.replace(/(\.[^./]*)?$/, `-${number}$1`);
    all.delete(name);
    all.set(name, { file, path: name });
  }
  return [...all.values()];
}

function isSame(one: File | undefined, other: File): boolean {
  return one?.size === other.size && one.lastModified === other.lastModified;
}

/** Why these files cannot become one scene; empty if they can. What the limits are may not be known yet. */
export function problemOf(files: readonly ChosenFile[], limits: Limits | null): string {
  const total = totalBytes(files);
  const images = files.filter(({ path }) => isPhoto(path)).length;
  if (limits) {
    const { maxBytes, bytesLeft, maxImages } = limits;
    if (total > maxBytes) return texts.upload.tooLarge(bytesText(total), bytesText(maxBytes));
    if (bytesLeft !== null && total > bytesLeft) return texts.quota.tooLittle(bytesText(total), bytesText(bytesLeft));
    if (images > 2 * maxImages) return texts.quota.tooMany(images, maxImages); // every one may have a mask or labels
  }
  const wholes = files.filter(({ path }) => WHOLE.test(path) && !SPLAT.test(path));
  return wholes.length > 0 && files.length > 1 ? texts.upload.oneArchive : "";
}

/** What to say of files that can be sent; empty for nothing. Poses beside photos make fewer of them enough. */
export function remarkOn(files: readonly ChosenFile[]): string {
  const few = files.length < FEW_PHOTOS && files.every(({ path }) => isPhoto(path));
  return few ? texts.upload.few(files.length, FEW_PHOTOS) : "";
}

export function totalBytes(files: readonly ChosenFile[]): number {
  return files.reduce((sum, { file }) => sum + file.size, 0);
}

/** The files of a list from an <input>. */
export function chosen(list: FileList | null): ChosenFile[] {
  return [...(list ?? [])].map((file) => ({ file, path: file.webkitRelativePath || file.name }));
}

/** The files of something dropped, those in folders too. */
export async function dropped(transfer: DataTransfer): Promise<ChosenFile[]> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  return (await Promise.all(entries.map((entry) => filesOf(entry)))).flat();
}

async function filesOf(entry: FileSystemEntry): Promise<ChosenFile[]> {
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
    return [{ file, path: entry.fullPath.replace(/^\//, "") }];
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const found: ChosenFile[] = [];
  for (;;) {
    const batch = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (batch.length === 0) return found;
    for (const child of batch) found.push(...(await filesOf(child)));
  }
}
