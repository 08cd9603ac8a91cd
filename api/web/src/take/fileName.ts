const LONGEST = 80;

/** A file name that every system takes, of a scene's or object's name; `fallback` where nothing of it is left. */
export function fileName(name: string, fallback: string, ending: string): string {
  const safe = name
    .normalize("NFC")
    .replace(/[^\p{L}\p{N} ._-]+/gu, "_")
    .replace(/^[\s._]+|[\s._]+$/g, "");
  return `${Array.from(safe).slice(0, LONGEST).join("") || fallback}.${ending}`;
}
