import { batch, computed, signal } from "@preact/signals";

import * as calls from "../api/calls";
import { isAbort } from "../api/http";
import type { Answer, Edit, Operation, PickedObject, Scene, SceneObject, SceneVersion } from "../api/types";
import { poseOf } from "../viewer/poses";
import { fromBase64, unpackBits } from "../viewer/states";
import type { SeenPlace } from "./changeState";
import { ChangeState } from "./changeState";
import { LookState } from "./lookState";
import { geometryVersion } from "./versions";

/** What the panel beside the view is about. */
type PanelTab = "ask" | "objects" | "photos" | "share";

/** A scene on show: what the server says of it, what was asked, and which objects are selected. */
export class SceneState {
  readonly scene = signal<Scene | null>(null);
  readonly operation = signal<Operation | null>(null);
  readonly versions = signal<readonly SceneVersion[]>([]);
  readonly objects = signal<readonly SceneObject[] | null>(null);
  readonly parts = signal<readonly SceneObject[]>([]);
  /** The version whose objects these are. */
  readonly objectsVersion = signal("");
  readonly owners = signal<Uint16Array | null>(null);
  readonly error = signal<unknown>(null);
  readonly actionError = signal<unknown>(null);
  readonly message = signal("");
  readonly busy = signal(false);

  /** The version that the address asks for; empty: the current one. */
  readonly askedVersion = signal("");
  readonly text = signal("");
  readonly answer = signal<Answer | null>(null);
  readonly answerError = signal<unknown>(null);
  readonly asking = signal(false);

  /** How the scene is looked at. */
  readonly look = new LookState(this);

  readonly tab = signal<PanelTab>("ask");
  readonly selected = signal<readonly number[]>([]);
  /** Bytes, 1 for the Gaussians of the part that is selected; null while none is. */
  readonly partRows = computed(() => {
    const own = this.#pickedPart.value;
    return own && this.selected.value.includes(own.id) ? own.rows : null;
  });
  readonly hovered = signal(0);

  readonly version = computed(() => this.askedVersion.value || (this.scene.value?.version ?? ""));
  /** What the person is changing on show. */
  readonly change = new ChangeState();
  /** The version that the last edit made. */
  readonly made = signal<SceneVersion | null>(null);
  /** Another version that the 3D view shows meanwhile; empty for none. */
  readonly compared = signal("");
  readonly geometry = computed(() => geometryVersion(this.versions.value, this.compared.value || this.version.value));
  readonly isCurrent = computed(() => this.version.value === this.scene.value?.version);
  readonly found = computed(() => {
    const answer = this.answer.value;
    return answer?.mask3d && (answer.object_ids.length > 0 || answer.matches.some((match) => match.relevant))
      ? unpackBits(fromBase64(answer.mask3d), answer.gaussians)
      : null;
  });
  /** What lights up: one light at a time. While objects are looked at, what is selected; else what answers. */
  readonly lit = computed(() => {
    const objects = this.tab.value === "objects" || this.change.motion.value !== null;
    if (this.selected.value.length > 0 && (objects || !this.answer.value)) return "selection";
    return this.found.value ? "answer" : null;
  });
  readonly selectedObjects = computed(() =>
    this.selected.value.flatMap((id) =>
      [...(this.objects.value ?? []), ...this.parts.value].filter((object) => object.id === id),
    ),
  );
  readonly canUndo = computed(() => {
    const current = this.versions.value.find((version) => version.current);
    return this.isCurrent.value && Boolean(current?.parent);
  });
  readonly canRedo = computed(() => {
    const current = this.scene.value?.version;
    return this.isCurrent.value && this.versions.value.some((version) => version.parent === current);
  });

  readonly #pickedPart = signal<{ id: number; rows: Uint8Array } | null>(null);
  #loads = new AbortController();
  #question = new AbortController();

  constructor(readonly sceneId: string) {}

  /** Asks the server for the scene, and for its job while that is not done. */
  async refresh(): Promise<void> {
    const { signal } = this.#loads;
    try {
      const scene = await calls.getScene(this.sceneId, signal);
      const versions = scene.version ? await calls.listVersions(this.sceneId) : [];
      const operation = scene.state === "READY" ? null : await calls.getOperation(scene.operation_id, signal);
      if (signal.aborted) return;
      batch(() => {
        this.scene.value = scene;
        this.operation.value = operation;
        this.versions.value = versions;
        this.error.value = null;
      });
    } catch (error) {
      if (!signal.aborted && !isAbort(error)) this.error.value = error;
    }
  }

  /** Loads the objects of the version on show, and which Gaussians are theirs. */
  async loadObjects(): Promise<void> {
    const version = this.version.value;
    const { signal } = this.#loads;
    try {
      const [everything, owners] = await Promise.all([
        calls.listObjects(this.sceneId, version),
        calls.objectsOfGaussians(this.sceneId, version, signal),
      ]);
      if (signal.aborted || version !== this.version.value) return;
      batch(() => {
        this.objects.value = everything.filter((object) => !object.parent);
        this.parts.value = everything.filter((object) => object.parent);
        this.objectsVersion.value = version;
        this.owners.value = owners;
        // Which Gaussians a part has is known only of the one that was clicked.
        const shown = everything.filter((object) => !object.parent || object.id === this.#pickedPart.value?.id);
        const ids = new Set(shown.map((object) => object.id));
        this.selected.value = this.selected.value.filter((id) => ids.has(id));
      });
    } catch (error) {
      if (!signal.aborted && !isAbort(error)) this.actionError.value = error;
    }
  }

  /** Answers a text; an older question that is still on its way is given up. */
  async ask(text: string): Promise<void> {
    this.#question.abort();
    this.#question = new AbortController();
    const { signal } = this.#question;
    const [trimmed, version] = [text.trim(), this.version.value];
    this.text.value = text;
    if (!trimmed || !version) {
      batch(() => {
        this.answer.value = this.answerError.value = null;
        this.asking.value = false;
      });
      return;
    }
    this.asking.value = true;
    try {
      const view = this.change.view.peek();
      const answer = await calls.ask(this.sceneId, version, trimmed, view && poseOf(view), signal);
      if (signal.aborted) return;
      batch(() => {
        this.answer.value = answer;
        this.answerError.value = null;
      });
    } catch (error) {
      if (signal.aborted || isAbort(error)) return;
      batch(() => {
        this.answer.value = null;
        this.answerError.value = error;
      });
    } finally {
      if (!signal.aborted) this.asking.value = false;
    }
  }

  pick(place: SeenPlace, signal: AbortSignal, more?: Parameters<typeof calls.pick>[5]): Promise<PickedObject> {
    return calls.pick(this.sceneId, this.version.value, place.camera, place.pixel, signal, more);
  }

  /** Selects what was picked: a part, an object, or the objects of a group. */
  selectPicked(picked: PickedObject): void {
    const level = picked.levels.find((each) => each.level === picked.level);
    if (!level) return;
    const rows = picked.mask3d && unpackBits(fromBase64(picked.mask3d), this.owners.value?.length ?? 0);
    batch(() => {
      this.actionError.value = null;
      this.#pickedPart.value = rows ? { id: level.id, rows } : null;
      this.selected.value = level.level === "group" ? level.members : [level.id];
      this.tab.value = "objects";
    });
  }

  /** Selects an object; with `more`, beside those selected, or no longer. */
  select(id: number, more = false): void {
    const before = this.selected.value;
    const others = before.filter((each) => each !== id);
    this.actionError.value = null;
    this.tab.value = "objects";
    if (!more) this.selected.value = [id];
    else this.selected.value = others.length < before.length ? others : [...before, id];
  }

  /** Lights up an object while something else than objects is looked at. */
  glow(id: number): void {
    void this.ask("");
    this.selected.value = [id];
  }

  clearSelection(): void {
    this.selected.value = [];
  }

  /** Makes a new version; true if the server took the edit. */
  async edit(edit: Partial<Edit>, message: string): Promise<boolean> {
    return this.editAll([edit], message);
  }

  /** The same of several edits, in order. */
  async editAll(edits: Partial<Edit>[], message: string): Promise<boolean> {
    const made = async () => (this.made.value = await calls.edit(this.sceneId, this.version.value, edits));
    return this.#change(made, message);
  }

  async undo(message: string): Promise<boolean> {
    return this.#change(() => calls.undo(this.sceneId, this.version.value), message);
  }

  async redo(message: string): Promise<boolean> {
    return this.#change(() => calls.redo(this.sceneId, this.version.value), message);
  }

  /** Makes any version the current one, and shows it. */
  async restore(version: string, message: string): Promise<boolean> {
    const current = this.scene.value?.version ?? "";
    return this.#change(() => calls.restore(this.sceneId, version, current), message);
  }

  /** Makes a version by another call than those above, and shows it; true if the server took it. */
  async make(call: () => Promise<unknown>, message: string): Promise<boolean> {
    return this.#change(call, message);
  }

  async #change(call: () => Promise<unknown>, message: string): Promise<boolean> {
    this.busy.value = true;
    this.actionError.value = null;
    this.message.value = "";
    try {
      await call();
      await this.refresh();
      await this.loadObjects();
      if (this.text.value) await this.ask(this.text.value);
      this.message.value = message;
      return true;
    } catch (error) {
      this.actionError.value = error;
      return false;
    } finally {
      this.busy.value = false;
    }
  }

  /** Notices a version that somebody else has made; true if there was one. */
  async notice(): Promise<boolean> {
    if (this.busy.value || !this.scene.value?.version) return false;
    const versions = await calls.listVersions(this.sceneId);
    const current = versions.find((version) => version.current)?.version;
    if (!current || current === this.scene.value.version) return false;
    await this.refresh();
    return true;
  }

  close(): void {
    this.#loads.abort();
    this.#question.abort();
  }
}
