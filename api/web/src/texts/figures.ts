/** A number with its noun: "1 photo", "2,000 photos". */
export function plural(count: number, one: string, many: string): string {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}

/** A share, 0..1, in whole percent. */
export function percent(share: number): string {
  return `${Math.round(100 * share)} %`;
}

/** Bytes as people say them. */
export function bytesText(bytes: number): string {
  const units = ["B", "kB", "MB", "GB"];
  const power = Math.min(units.length - 1, Math.floor(Math.log10(Math.max(bytes, 1)) / 3));
  const value = bytes / 1000 ** power;
  return `${value >= 100 || power === 0 ? Math.round(value) : value.toFixed(1)} ${units[power] ?? ""}`;
}

/** The day of a moment. */
export function dayText(moment: string): string {
  return new Date(moment).toLocaleDateString("en", { dateStyle: "medium" });
}

/** A moment to the minute. */
export function momentText(moment: string): string {
  return new Date(moment).toLocaleString("en", { dateStyle: "medium", timeStyle: "short" });
}
