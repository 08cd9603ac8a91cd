/** What the address says: which page, and its parameters. Behind the `#`, so that any proxy may show the page. */
export type Route =
  | { page: "scenes" }
  | { page: "new" }
  | { page: "server" }
  | { page: "phone" }
  | { page: "scene"; sceneId: string; text: string; version: string; view: string }
  | { page: "unknown" };

export function parseRoute(hash: string): Route {
  const [path = "", query = ""] = hash.replace(/^#/, "").split("?", 2);
  const parameters = new URLSearchParams(query);
  if (path === "" || path === "/") return { page: "scenes" };
  if (path === "/new") return { page: "new" };
  if (path === "/phone") return { page: "phone" };
  if (path === "/server") return { page: "server" };
  const match = /^\/scenes\/([^/]+)$/.exec(path);
  if (!match?.[1]) return { page: "unknown" };
  return {
    page: "scene",
    sceneId: safelyDecoded(match[1]),
    text: parameters.get("q") ?? "",
    version: parameters.get("version") ?? "",
    view: parameters.get("view") ?? "",
  };
}

/** The address of a scene with what is asked, which version, and from where it is looked at; relative, begins with #. */
export function sceneAddress(sceneId: string, more: { text?: string; version?: string; view?: string } = {}): string {
  const query = new URLSearchParams();
  if (more.text) query.set("q", more.text);
  if (more.version) query.set("version", more.version);
  if (more.view) query.set("view", more.view);
  const tail = query.toString();
  return `#/scenes/${encodeURIComponent(sceneId)}${tail ? `?${tail}` : ""}`;
}

function safelyDecoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}
