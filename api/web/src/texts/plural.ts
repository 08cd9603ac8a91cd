/** A number with its noun: "1 photo", "2,000 photos". */
export function plural(count: number, one: string, many: string): string {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}
