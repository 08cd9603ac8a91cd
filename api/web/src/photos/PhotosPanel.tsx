import { useState } from "preact/hooks";

import { listPhotos } from "../api/adminCalls";
import { listPhotos as listStored } from "../api/photoCalls";
import type { PhotoVerdict } from "../api/types";
import { texts } from "../texts";
import { Check } from "../ui/fields";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { StoredPhoto } from "./StoredPhoto";

/** What became of each photo and what to do about it. `round` changes when there may be news; `ready`: of the scene. */
export function PhotosPanel({ sceneId, ready, round = "" }: { sceneId: string; ready: boolean; round?: string }) {
  const [all, setAll] = useState(false);
  const { value, error, reload } = useLoaded(() => listPhotos(sceneId), [sceneId, round]);
  const stored = useLoaded(
    (signal) => (ready ? listStored(sceneId, "", signal) : Promise.resolve(new Set<string>())),
    [sceneId, ready],
  );
  if (error !== null) return <ErrorNote error={error} onRetry={reload} />;
  if (!value || (!value.assessed && !ready)) return null;
  const troubled = value.photos.filter((photo) => !photo.placed || photo.defects.length > 0);
  const shown = all ? value.photos : troubled;
  return (
    <section class="photos" aria-labelledby="photos-title">
      <h2 id="photos-title">{texts.photos.title}</h2>
      {!value.assessed ? (
        <p class="hint">{texts.photos.notAssessed}</p>
      ) : (
        <p class="hint" role="status">
          {texts.photos.placed(value.photos.filter((photo) => photo.placed).length, value.photos.length)}{" "}
          {troubled.length === 0 ? texts.photos.fine : texts.photos.troubled(troubled.length)}
        </p>
      )}
      {value.assessed && <Check label={texts.photos.showAll} checked={all} onChange={setAll} />}
      {shown.length > 0 && (
        <ul class="photo-list">
          {shown.map((photo) => (
            <li key={photo.name}>
              <Picture sceneId={sceneId} photo={photo} stored={stored.value} />
              <Photo photo={photo} />
            </li>
          ))}
        </ul>
      )}
    </section>
  );
}

interface PictureProperties {
  sceneId: string;
  photo: PhotoVerdict;
  stored: ReadonlySet<string> | null;
}

/** The photo itself where it is stored, or else the one beside which another one is to be taken. */
function Picture({ sceneId, photo, stored }: PictureProperties) {
  const view = [photo.name, ...photo.between].find((name) => stored?.has(name));
  if (!view) return null;
  return <StoredPhoto sceneId={sceneId} view={view} caption={view === photo.name ? "" : texts.photos.beside(view)} />;
}

function Photo({ photo }: { photo: PhotoVerdict }) {
  const words = [
    photo.placed ? texts.photos.isPlaced : texts.photos.notPlaced[photo.not_placed ?? "unknown"],
    ...photo.defects.map((defect) => texts.photos.defects[defect]),
  ];
  return (
    <div>
      <span class="photo-name">{photo.name}</span>
      <ul class="tags">
        {words.map((word, index) => (
          <li key={word} class={index > 0 || !photo.placed ? "state failed" : "state ready"}>
            {word}
          </li>
        ))}
      </ul>
      {photo.withheld > 0 && <p class="hint">{texts.privacy.ofPhoto(photo.withheld)}</p>}
      {photo.advice && <p class="hint">{photo.advice}</p>}
    </div>
  );
}
