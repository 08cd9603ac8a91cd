import { useEffect, useRef, useState } from "preact/hooks";

import { go, sceneAddress } from "../address/router";
import { newRequestId } from "../api/calls";
import { isAbort, OfflineError, send } from "../api/http";
import { serverStatus } from "../api/serverCalls";
import type { Operation, ServerStatus } from "../api/types";
import { texts } from "../texts";
import { bytesText } from "../texts/figures";
import { ErrorNote } from "../ui/parts";
import type { ChosenFile } from "./choose";
import { chosen, dropped, joined, problemOf, sorted, totalBytes } from "./choose";
import { ChosenFiles } from "./ChosenFiles";
import { Estimate } from "./Estimate";
import { limitsOf, refusalOf } from "./limits";
import { PhoneLink } from "./PhoneLink";
import { PhotoGuide } from "./PhotoGuide";
import { discard, forget, sendFile, wasBegun } from "./tus";
import { usePhotoChecks } from "./usePhotoChecks";
import { WithholdPeople } from "./WithholdPeople";
import "./upload.css";

type Preset = keyof typeof texts.upload.presets;

/** Files are chosen, checked before anything is sent, sent in pieces, and made a scene of. */
export function UploadPage({ onCreated }: { onCreated?: (operation: Operation) => void }) {
  const [files, setFiles] = useState<ChosenFile[]>([]);
  const [refused, setRefused] = useState<string[]>([]);
  const [status, setStatus] = useState<ServerStatus | null>(null);
  const [over, setOver] = useState(false);
  const [sent, setSent] = useState<{ bytes: number; speed: number } | null>(null);
  const [stopped, setStopped] = useState(false);
  const [error, setError] = useState<unknown>(null);
  const [preset, setPreset] = useState<Preset>("");
  const running = useRef<AbortController | null>(null);
  const requestId = useRef(newRequestId());
  const form = useRef<HTMLFormElement>(null);
  const checks = usePhotoChecks(files);

  useEffect(() => {
    serverStatus().then(setStatus, () => undefined); // the server says so itself when the file is announced
    return () => running.current?.abort();
  }, []);

  const add = (more: ChosenFile[]) => {
    const { taken, refused } = sorted(more);
    requestId.current = newRequestId();
    setFiles((before) => joined(before, taken));
    setRefused(refused);
    setError(null);
    setStopped(false);
  };
  const remove = (gone: readonly ChosenFile[]) => {
    requestId.current = newRequestId();
    setFiles((before) => before.filter((each) => !gone.includes(each)));
    setError(null);
    void discard(gone);
  };
  const problem = problemOf(files, status && limitsOf(status));
  const refusal = status ? refusalOf(status) : "";
  const total = totalBytes(files);

  const upload = async () => {
    const controller = (running.current = new AbortController());
    setError(null);
    setStopped(false);
    try {
      const ids = await sendAll(files, controller.signal, (bytes, speed) => setSent({ bytes, speed }));
      const operation = await createScene(new FormData(form.current ?? undefined), ids, requestId.current);
      forget(files);
      if (onCreated) onCreated(operation);
      else go(sceneAddress(operation.scene_id));
    } catch (problem) {
      setStopped(true);
      if (!isAbort(problem)) setError(problem);
    } finally {
      running.current = null;
      setSent((before) => before && { ...before, speed: 0 });
    }
  };

  const busy = running.current !== null && !stopped;
  return (
    <section class="sheet upload">
      <h1>{texts.upload.title}</h1>
      <p>{texts.upload.intro}</p>
      {refusal && (
        <p class="note error" role="alert">
          {refusal} {!onCreated && <a href="#/server">{texts.quota.toServer}</a>}
        </p>
      )}
      <form
        ref={form}
        onSubmit={(event) => {
          event.preventDefault();
          if (!busy && files.length && !problem && !refusal) void upload();
        }}
      >
        <div
          class={over ? "drop over" : "drop"}
          onDragOver={(event) => {
            event.preventDefault();
            setOver(true);
          }}
          onDragLeave={() => setOver(false)}
          onDrop={(event) => {
            event.preventDefault();
            setOver(false);
            if (event.dataTransfer) dropped(event.dataTransfer).then(add, setError);
          }}
        >
          <p>{texts.upload.drop}</p>
          <div class="buttons">
            <FileButton text={texts.upload.choose} onChoose={add} />
            <FileButton text={texts.upload.chooseFolder} onChoose={add} kind="folder" />
            <FileButton text={texts.upload.camera} onChoose={add} kind="camera" />
          </div>
        </div>
        {refused.length > 0 && (
          <div class="note error" role="alert">
            <p>{texts.upload.left}</p>
            <ul>
              {refused.map((reason) => (
                <li key={reason}>{reason}</li>
              ))}
            </ul>
          </div>
        )}
        {files.length === 0 && <PhotoGuide />}
        <ChosenFiles files={files} checks={checks} busy={busy} onRemove={remove} />
        {problem && (
          <p class="note error" role="alert">
            {problem}
          </p>
        )}
        <label>
          {texts.upload.name}
          <input name="name" maxLength={200} autocomplete="off" />
        </label>
        <label>
          {texts.upload.labels}
          <input name="labels" autocomplete="off" />
        </label>
        <label>
          {texts.upload.preset}
          <select name="preset" value={preset} onChange={(event) => setPreset(event.currentTarget.value as Preset)}>
            {(Object.keys(texts.upload.presets) as Preset[]).map((each) => (
              <option key={each} value={each}>
                {texts.upload.presets[each]}
              </option>
            ))}
          </select>
        </label>
        {status && !problem && <Estimate files={files} checks={checks} preset={preset} />}
        <WithholdPeople />
        {sent && (
          <div class="sending">
            <progress max={total} value={sent.bytes} aria-label={texts.upload.progress} />
            <p class="hint">{texts.upload.sending(bytesText(sent.bytes), bytesText(total), bytesText(sent.speed))}</p>
          </div>
        )}
        {!busy && !stopped && files.some(wasBegun) && <p class="note">{texts.upload.resumed}</p>}
        {error instanceof OfflineError ? (
          <p class="note error" role="alert">
            {texts.upload.interrupted}
          </p>
        ) : (
          error !== null && <ErrorNote error={error} />
        )}
        <div class="buttons">
          <button class="primary" disabled={busy || files.length === 0 || problem !== "" || refusal !== ""}>
            {stopped ? texts.upload.resume : texts.upload.submit}
          </button>
          {busy && (
            <button type="button" onClick={() => running.current?.abort()}>
              {texts.upload.pause}
            </button>
          )}
        </div>
      </form>
      {!onCreated && !refusal && status && <PhoneLink addresses={status.addresses} />}
    </section>
  );
}

interface FileButtonProperties {
  text: string;
  onChoose: (files: ChosenFile[]) => void;
  kind?: "files" | "folder" | "camera";
}

function FileButton({ text, onChoose, kind = "files" }: FileButtonProperties) {
  const more = kind === "camera" ? { accept: "image/*", capture: "environment" as const } : {};
  return (
    <label class="button">
      {text}
      <input
        class="sr-only"
        type="file"
        multiple
        {...more}
        ref={(input) => {
          if (input && kind === "folder") input.webkitdirectory = true;
        }}
        onChange={(event) => {
          onChoose(chosen(event.currentTarget.files));
          event.currentTarget.value = "";
        }}
      />
    </label>
  );
}

async function sendAll(
  files: readonly ChosenFile[],
  signal: AbortSignal,
  sent: (bytes: number, speed: number) => void,
): Promise<string[]> {
  const ids: string[] = [];
  const begin = performance.now();
  let done = 0;
  let there = 0; // bytes that an earlier attempt has sent
  for (const each of files) {
    let first = true;
    const before = done;
    const id = await sendFile(each, signal, (bytes) => {
      if (first) there += bytes;
      first = false;
      const seconds = Math.max((performance.now() - begin) / 1000, 0.1);
      sent(before + bytes, Math.max(0, before + bytes - there) / seconds);
    });
    ids.push(id);
    done += each.file.size;
  }
  return ids;
}

async function createScene(chosen: FormData, uploads: readonly string[], requestId: string): Promise<Operation> {
  const form = new FormData();
  for (const [name, value] of chosen) if (typeof value === "string" && value) form.append(name, value);
  form.append("request_id", requestId);
  for (const id of uploads) form.append("uploads", id);
  return (await (await send("v1/scenes", { method: "POST", body: form })).json()) as Operation;
}
