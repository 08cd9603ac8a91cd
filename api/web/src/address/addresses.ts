/** What the address says: which page, and its parameters. Behind the `#`, so that any proxy may show the page. */
export type Route =
  | { page: "scenes" }
  | { page: "new" }
  | { page: "server" }
  | { page: "phone" }
  | { page: "scene"; sceneId: string; text: string; version: string; view: string; objects: number[]; look: string }
  | { page: "unknown" };

export function parseRoute(hash: string): Route {
  const [path = "", query = ""] = hash.replace(/^#/, "").split("?", 2);
  const parameters = new URLSearchParams(query);
  if (path === "" || path === "/" || isPlace(hash)) return { page: "scenes" };
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
    objects: (parameters.get("objects") ?? "")
      .split(",")
      .map(Number)
      .filter((id) => Number.isInteger(id) && id > 0),
    look: parameters.get("look") ?? "",
  };
}

/** Whether an address leads to a place on a page, e.g. to its content, and to no page. */
export function isPlace(hash: string): boolean {
  return /^#[^/]/.test(hash);
}

/** What the address of a scene says beside the scene. */
export interface SceneAddress {
  text?: string;
  version?: string;
  view?: string;
  /** Ids of the objects that are selected. */
  objects?: readonly number[];
  /** How it is looked at, see `look/`. */
  look?: string;
  /** The key of a link that shows the scene to whoever has it. */
  share?: string;
}

/** The relative address (#...) of a scene: with question, version, view, way of looking and selected objects. */
export function sceneAddress(sceneId: string, more: SceneAddress = {}): string {
  const query = new URLSearchParams();
  if (more.text) query.set("q", more.text);
  if (more.version) query.set("version", more.version);
  if (more.view) query.set("view", more.view);
  if (more.objects?.length) query.set("objects", more.objects.join(","));
  if (more.look) query.set("look", more.look);
  if (more.share) query.set("share", more.share);
  const tail = query.toString().replaceAll("%2C", ",");
  return `#/scenes/${encodeURIComponent(sceneId)}${tail ? `?${tail}` : ""}`;
}

/** The key in an address that shows one scene; "" without one. Behind the `#`, so that it reaches no server's log. */
export function shareKeyIn(hash: string): string {
  return new URLSearchParams(hash.split("?", 2)[1] ?? "").get("share") ?? "";
}

function safelyDecoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}
