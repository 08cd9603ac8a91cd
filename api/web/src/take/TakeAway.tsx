import { useState } from "preact/hooks";

import { isShared } from "../address/share";
import { exportPath, fileSize, maskPly, splatPath } from "../api/calls";
import type { Scene } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { bytesText } from "../texts/figures";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import type { LookAt } from "../viewer/poses";
import { cameraOf } from "../viewer/poses";
import { exportBytes } from "./exportSizes";
import { fileName } from "./fileName";
import type { FileNaming } from "./save";
import { keep, save } from "./save";
import { SharePanel } from "./SharePanel";

const SIZES = [
  [1280, 720],
  [1920, 1080],
  [1080, 1920],
  [2048, 2048],
] as const;

const { formats: FORMATS, kinds: KINDS } = texts.take;
const names = <Key extends string>(labels: Record<Key, string>) => Object.keys(labels) as Key[];

interface Properties {
  state: SceneState;
  scene: Scene;
  /** From where the scene is looked at now. */
  view: () => LookAt;
}

interface Running {
  label: string;
  bytes: number;
  of: number;
}

/** Everything that can be taken away: the scene, an object, masks, cameras, a picture, a link. */
export function TakeAway({ state, scene, view }: Properties) {
  const [running, setRunning] = useState<Running | null>(null);
  const [error, setError] = useState<unknown>(null);
  const [size, setSize] = useState(0);
  const version = state.version.value;
  const { value: spz } = useLoaded((signal) => fileSize(splatPath(scene.id, version, false), signal), [version]);
  const path = `v1/scenes/${encodeURIComponent(scene.id)}`;
  const answer = state.answer.value;
  const named = (ending: string, of = scene.name, fallback = "scene") => fileName(of, fallback, ending);

  const take = (label: string, name: FileNaming, address: string, body?: unknown) => {
    setError(null);
    setRunning({ label, bytes: 0, of: 0 });
    const progress = (bytes: number, of: number) => setRunning({ label, bytes, of });
    const options =
      body === undefined
        ? {}
        : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
    save(address, name, progress, options)
      .catch(setError)
      .finally(() => setRunning(null));
  };
  const item = (
    label: string,
    name: FileNaming,
    address: string,
    body?: () => unknown,
    bytes: number | null = null,
  ) => (
    <li key={label}>
      <Button disabled={running !== null} onClick={() => take(label, name, address, body?.())} text={label} />
      {bytes !== null && <span class="hint"> {texts.take.about(bytesText(bytes))}</span>}
    </li>
  );
  const [width, height] = SIZES[size] ?? SIZES[0];
  const camera = () => cameraOf(view(), width, height);
  const instead = (
    <Button
      class="primary"
      disabled={running !== null}
      onClick={() => take(FORMATS.html, named, exportPath(scene.id, "html", version))}
      text={texts.take.saveHtml}
    />
  );
  const whatThereIs = (
    <section class="take" aria-labelledby="take-title">
      <h2 id="take-title">{texts.take.title}</h2>
      {running && (
        <div role="status">
          <p>{texts.take.running(running.label, running.bytes, running.of)}</p>
          {running.of > 0 && <progress max={running.of} value={running.bytes} aria-label={running.label} />}
        </div>
      )}
      {error !== null && <ErrorNote error={error} />}
      <h3>{texts.take.whole}</h3>
      <ul class="chips">
        {names(FORMATS).map((format) =>
          item(
            FORMATS[format],
            named,
            exportPath(scene.id, format, version),
            undefined,
            exportBytes(scene, spz, format),
          ),
        )}
      </ul>
      {state.selectedObjects.value.map((object) => (
        <div key={object.id}>
          <h3>{texts.objects.titleOf(object)}</h3>
          <ul class="chips">
            {names(KINDS).map((format) =>
              item(
                texts.take.alone(texts.objects.titleOf(object), KINDS[format]),
                (ending) => named(ending, texts.objects.titleOf(object), "object"),
                exportPath(scene.id, format, version, [object.id]),
              ),
            )}
          </ul>
        </div>
      ))}
      {answer && (answer.object_ids.length > 0 || answer.matches.some((match) => match.relevant)) && (
        <>
          <h3>{texts.take.masks(answer.text)}</h3>
          <ul class="chips">
            <li>
              <Button
                disabled={running !== null}
                onClick={() => {
                  setError(null);
                  maskPly(scene.id, version, answer.text).then(
                    (bytes) => keep(new Blob([bytes]), named("ply", answer.text, "mask")),
                    setError,
                  );
                }}
                text={texts.take.maskPly}
              />
            </li>
            {item(
              texts.take.mask3d,
              named("bin", answer.text, "mask"),
              `${path}/mask3d.bin?${new URLSearchParams({ text: answer.text, version })}`,
            )}
            {item(texts.take.mask2d, named("mask.png", answer.text, "mask"), `${path}:render`, () => ({
              kind: "mask",
              text: answer.text,
              version,
              camera: camera(),
            }))}
          </ul>
        </>
      )}
      <h3>{texts.take.picture}</h3>
      <label>
        {texts.take.size}
        <select value={size} onChange={(event) => setSize(Number(event.currentTarget.value))}>
          {SIZES.map(([w, h], index) => (
            <option key={index} value={index}>
              {`${w} × ${h}`}
            </option>
          ))}
        </select>
      </label>
      <ul class="chips">
        {item(texts.take.png, named("png"), `${path}:render`, () => ({ kind: "rgb", version, camera: camera() }))}
        {(["depth", "normals", "confidence"] as const).map((kind) =>
          item(texts.take[kind], named(`${kind}.npy`), `${path}:render`, () => ({
            kind,
            format: "npy",
            version,
            camera: camera(),
          })),
        )}
      </ul>
      <h3>{texts.take.cameras}</h3>
      <ul class="chips">
        {item(texts.take.transforms, named, exportPath(scene.id, "transforms", version))}
        {item(texts.take.colmap, named, exportPath(scene.id, "colmap", version))}
        {item(texts.take.camerasWithPoints, named, exportPath(scene.id, "cameras", version))}
        {item(texts.take.camerasJson, named, exportPath(scene.id, "camera_list", version))}
      </ul>
    </section>
  );
  return (
    <>
      {!isShared && <SharePanel sceneId={scene.id} instead={instead} />}
      {whatThereIs}
    </>
  );
}
