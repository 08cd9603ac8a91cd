/**
 * A message of the server begins with a small letter and has no full stop: it is one clause of a longer line elsewhere.
 * One that begins with the name of the file that it is about keeps that name's spelling.
 */
export function sentence(text: string, field = ""): string {
  const trimmed = text.trim();
  if (!trimmed) return trimmed;
  const isFile = /[./]/.test(field) && trimmed.startsWith(field);
  const begun = isFile ? trimmed : trimmed.charAt(0).toUpperCase() + trimmed.slice(1);
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}
