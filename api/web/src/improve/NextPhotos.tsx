import { signal } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";

import { getJson } from "../api/http";
import type { NextPhotoList, PosedCamera } from "../api/types";
import type { LookState } from "../state/lookState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { rayOf } from "../viewer/poses";
import { drawnDepth, frustumOf, pathPoint, Projection } from "../viewer/projection";
import { add, scale } from "../viewer/vectors";
import "./improve.css";

/** Cameras that no photo was taken with yet, while their list is open. */
const hollow = signal<readonly PosedCamera[]>([]);

const SIGHT = 4; // as long as the drawn camera: how far the line in its direction goes

interface Props {
  sceneId: string;
  version: string;
  onFly: (camera: PosedCamera) => void;
}

/** Where to stand for the next photos, in words; the 3D view shows the places as hollow cameras. */
export function NextPhotos(props: Props) {
  const [open, setOpen] = useState(false);
  return (
    <details class="improve" onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>{texts.nextPhotos.title}</summary>
      {open && <Places {...props} />}
    </details>
  );
}

function Places({ sceneId, version, onFly }: Props) {
  const { value, error } = useLoaded(
    (signal) =>
      getJson<NextPhotoList>(
        `v1/scenes/${encodeURIComponent(sceneId)}/next-photos?version=${encodeURIComponent(version)}`,
        signal,
      ),
    [sceneId, version],
  );
  useEffect(() => {
    hollow.value = value?.photos.map((photo) => photo.camera) ?? [];
    return () => {
      hollow.value = [];
    };
  }, [value]);
  if (error !== null) return <ErrorNote error={error} />;
  if (!value) return <Loading />;
  if (value.photos.length === 0) return <p>{texts.nextPhotos.none}</p>;
  return (
    <ol>
      {value.photos.map((photo, index) => (
        <li key={index}>
          {photo.advice} <Button onClick={() => onFly(photo.camera)} text={texts.nextPhotos.fly} />
        </li>
      ))}
    </ol>
  );
}

/** The hollow cameras over the 3D view, in its perspective; the list says the same in words. */
export function HollowCameras({ look }: { look: LookState }) {
  const cameras = hollow.value;
  const [view, size] = [look.view.value, look.size.value];
  if (cameras.length === 0 || !view || !size.width) return null;
  const projection = new Projection(view, size);
  const depth = drawnDepth(look.all.value);
  return (
    <svg class="frusta hollow" viewBox={`0 0 ${size.width} ${size.height}`} aria-hidden="true">
      {cameras.map((camera, index) => {
        const { apex, corners } = frustumOf(camera, depth);
        const edges = corners.flatMap((corner, number) => [
          projection.line(apex, corner),
          projection.line(corner, corners[(number + 1) % corners.length] ?? corner),
        ]);
        const { position, forward } = rayOf(camera);
        edges.push(projection.line(position, add(position, scale(forward, SIGHT * depth)))); // where it is to look
        const place = projection.point(position);
        const path = edges.map((edge) => (edge ? `M${pathPoint(edge[0])}L${pathPoint(edge[1])}` : "")).join("");
        return (
          <g key={index} data-next={index}>
            <path class="halo" d={path} />
            <path d={path} />
            {place && (
              <text x={place[0]} y={place[1] - 8}>
                {index + 1}
              </text>
            )}
          </g>
        );
      })}
    </svg>
  );
}
