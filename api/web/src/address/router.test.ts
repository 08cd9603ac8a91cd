import { beforeEach, expect, test, vi } from "vitest";

/** A window's address and history. As in a browser, the event of a new hash comes later than the hash. */
class Tab {
  readonly entries = [new URL("http://page/#/scenes/a")];
  #listener = (): void => undefined;

  readonly addEventListener = (_: string, listener: () => void): void => {
    this.#listener = listener;
  };

  readonly location = Object.defineProperty({ hash: "" }, "hash", {
    get: () => this.#present.hash,
    set: (hash: string) => this.entries.push(new URL(hash, this.#present)),
  });

  readonly history = {
    replaceState: (_state: unknown, _title: string, address: string): void => {
      this.entries.splice(-1, 1, new URL(address, this.#present));
    },
  };

  tell(): void {
    this.#listener();
  }

  get hashes(): string[] {
    return this.entries.map(({ hash }) => hash);
  }

  get #present(): URL {
    return this.entries.at(-1) ?? new URL("http://page/");
  }
}

let tab: Tab;
let router: typeof import("./router");

beforeEach(async () => {
  tab = new Tab();
  vi.stubGlobal("window", tab);
  vi.stubGlobal("location", tab.location);
  vi.stubGlobal("history", tab.history);
  vi.stubGlobal("sessionStorage", { getItem: () => null });
  vi.resetModules();
  router = await import("./router");
});

test("an address is put right again and again without a new entry", () => {
  router.replaceAddress("#/scenes/a?view=1");
  router.replaceAddress("#/scenes/a?view=2");
  expect(tab.hashes).toEqual(["#/scenes/a?view=2"]);
});

test("an address that was gone to stays, although the browser has not told of it yet", () => {
  router.go("#/");
  router.replaceAddress("#/scenes/a?view=1");
  expect(tab.hashes).toEqual(["#/scenes/a", "#/"]);
  tab.tell();
  expect(router.route.value).toEqual({ page: "scenes" });
});

test("once the browser has told of an address, that one is put right", () => {
  router.go("#/scenes/b");
  tab.tell();
  router.replaceAddress("#/scenes/b?view=1");
  expect(tab.hashes).toEqual(["#/scenes/a", "#/scenes/b?view=1"]);
});
