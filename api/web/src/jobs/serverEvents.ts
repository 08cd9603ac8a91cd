/** One server-sent event (WHATWG HTML, section 9.2); `id` continues after it. */
interface ServerEvent {
  id: string;
  data: string;
  kind: string;
}

/** The whole events of a stream of text that comes in pieces; one that the end cuts off is none. */
export class EventReader {
  #rest = "";
  #id = "";
  #kind = "";
  #data: string[] = [];

  /** The events that are whole with this piece. */
  read(piece: string): ServerEvent[] {
    const lines = (this.#rest + piece).split(/\r\n|\n|\r/);
    this.#rest = lines.pop() ?? "";
    const events: ServerEvent[] = [];
    for (const line of lines) {
      if (line === "") {
        if (this.#data.length)
          events.push({ id: this.#id, data: this.#data.join("\n"), kind: this.#kind || "message" });
        this.#data = [];
        this.#kind = "";
      } else if (!line.startsWith(":")) {
        const [field, value] = split(line);
        if (field === "data") this.#data.push(value);
        else if (field === "id") this.#id = value;
        else if (field === "event") this.#kind = value;
      }
    }
    return events;
  }
}

function split(line: string): [string, string] {
  const at = line.indexOf(":");
  return at < 0 ? [line, ""] : [line.slice(0, at), line.slice(at + 1).replace(/^ /, "")];
}
