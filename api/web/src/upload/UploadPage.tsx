import { useEffect, useState } from "preact/hooks";

import { go, sceneAddress } from "../address/router";
import { serverStatus } from "../api/serverCalls";
import type { Operation, ServerStatus } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";
import type { ChosenFile } from "./choose";
import { chosen, dropped, joined, problemOf, sorted } from "./choose";
import { ChosenFiles } from "./ChosenFiles";
import { Estimate } from "./Estimate";
import { UploadState } from "./LeftUploads";
import { limitsOf, refusalOf } from "./limits";
import { PhoneLink } from "./PhoneLink";
import { PhotoGuide } from "./PhotoGuide";
import { discard, wasBegun } from "./tus";
import { leftUploads, Uploading } from "./uploading";
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
  const [upload, setUpload] = useState<Uploading | null>(null);
  const [preset, setPreset] = useState<Preset>("");
  const checks = usePhotoChecks(files);

  useEffect(() => {
    serverStatus().then(setStatus, () => undefined); // the server says so itself when the file is announced
  }, []);
  useEffect(
    () => () => {
      if (upload?.busy.peek()) leftUploads.value = [...leftUploads.peek(), upload];
    },
    [upload],
  );

  const add = (more: ChosenFile[]) => {
    const { taken, refused } = sorted(more);
    setFiles((before) => joined(before, taken));
    setRefused(refused);
    setUpload(null);
  };
  const remove = (gone: readonly ChosenFile[]) => {
    setFiles((before) => before.filter((each) => !gone.includes(each)));
    setUpload(null);
    void discard(gone);
  };
  const problem = problemOf(files, status && limitsOf(status));
  const refusal = status ? refusalOf(status) : "";
  const busy = upload?.busy.value ?? false;

  const send = async (form: HTMLFormElement) => {
    const begun = upload ?? new Uploading(files, form);
    setUpload(begun);
    await begun.run();
    const operation = begun.operation.peek();
    if (!operation || leftUploads.peek().includes(begun)) return; // the page shows something else by now
    if (onCreated) onCreated(operation);
    else go(sceneAddress(operation.scene_id));
  };

  return (
    <section class="sheet upload">
      <h1>{texts.upload.title}</h1>
      <p>{texts.upload.intro}</p>
      {refusal && (
        <p class="note error" role="alert">
          {refusal} {!onCreated && <a href="#/server">{texts.quota.toServer}</a>}
        </p>
      )}
      <Form
        onSubmit={(form) => {
          if (!busy && files.length && !problem && !refusal) void send(form);
        }}
      >
        {!busy && (
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
              if (event.dataTransfer) dropped(event.dataTransfer).then(add, () => setRefused([texts.errors.failed]));
            }}
          >
            <p>{texts.upload.drop}</p>
            <div class="buttons">
              <FileButton text={texts.upload.choose} onChoose={add} />
              <FileButton text={texts.upload.chooseFolder} onChoose={add} kind="folder" />
              <FileButton text={texts.upload.camera} onChoose={add} kind="camera" />
            </div>
          </div>
        )}
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
        {upload && <UploadState upload={upload} />}
        {!upload && files.some(wasBegun) && <p class="note">{texts.upload.resumed}</p>}
        <div class="buttons">
          <Button
            type="submit"
            class="primary"
            disabled={busy || files.length === 0 || problem !== "" || refusal !== ""}
            text={upload && !busy ? texts.upload.resume : texts.upload.submit}
          />
          {busy && <Button onClick={() => upload?.pause()} text={texts.upload.pause} />}
        </div>
      </Form>
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
