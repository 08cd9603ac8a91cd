/** Makes a sentence of a server's message, which is a clause; a file's name at its beginning keeps its spelling. */
export function sentence(text: string, field = ""): string {
  const trimmed = text.trim();
  if (!trimmed) return trimmed;
  const isFile = /[./]/.test(field) && trimmed.startsWith(field);
  const begun = isFile ? trimmed : trimmed.charAt(0).toUpperCase() + trimmed.slice(1);
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}
