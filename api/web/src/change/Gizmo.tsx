import { useEffect, useRef } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import type { Motion } from "../viewer/motions";
import { withAxis } from "../viewer/motions";
import type { Point } from "../viewer/projection";
import { Projection } from "../viewer/projection";
import type { Vec } from "../viewer/vectors";
import { add, dot, length, scale, subtract } from "../viewer/vectors";

const AXES: readonly Vec[] = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
];
const SHARE = 0.16; // of the distance to the object: how long the handles' axes are
const NUDGE = 0.02; // the same, of one press of an arrow key
const TURN = Math.PI / 36;

/** Three handles to shift the selected objects along the world's axes, and three to turn them about these. */
export function Gizmo({ state }: { state: SceneState }) {
  const { change } = state;
  const [view, size, motion] = [change.view.value, change.size.value, change.motion.value];
  const drag = useRef<{ from: Point; motion: Motion } | null>(null);
  const first = useRef<HTMLDivElement>(null);
  const shown = motion !== null;
  useEffect(() => {
    if (shown) first.current?.querySelector("button")?.focus({ preventScroll: true });
  }, [shown]);
  if (!view || !motion || !size.width) return null;
  const center = add(motion.pivot, motion.shift);
  const reach = SHARE * length(subtract(center, view.position));
  const projection = new Projection(view, size);
  const middle = projection.point(center);
  if (!middle) return null;
  const set = (next: Motion) => (change.motion.value = next);
  const handles = AXES.flatMap((axis, number) => {
    const far = projection.point(add(center, scale(axis, reach)));
    const near = projection.point(add(center, scale(axis, -reach)));
    if (!far || !near) return [];
    const along = [(far[0] - middle[0]) / reach, (far[1] - middle[1]) / reach] as const; // pixels a unit
    const pixels = along[0] ** 2 + along[1] ** 2;
    const towards = dot(axis, subtract(view.position, center)) > 0 ? -1 : 1; // the screen's y points down
    const shifted = (from: Motion, by: number) => ({
      ...from,
      shift: withAxis(from.shift, number, (from.shift[number] ?? 0) + by),
    });
    const turned = (from: Motion, by: number) => ({
      ...from,
      angles: withAxis(from.angles, number, (from.angles[number] ?? 0) + by),
    });
    const bearing = (point: Point) => Math.atan2(point[1] - middle[1], point[0] - middle[0]);
    return [
      {
        kind: "shift",
        number,
        at: far,
        label: texts.change.shiftAlong(AXIS_NAMES[number] ?? ""),
        nudge: (sign: number) => set(shifted(motion, sign * NUDGE * (reach / SHARE))),
        move: (from: Motion, start: Point, now: Point) =>
          pixels > 1 && set(shifted(from, ((now[0] - start[0]) * along[0] + (now[1] - start[1]) * along[1]) / pixels)),
      },
      {
        kind: "turn",
        number,
        at: near,
        label: texts.change.turnAbout(AXIS_NAMES[number] ?? ""),
        nudge: (sign: number) => set(turned(motion, sign * TURN)),
        move: (from: Motion, start: Point, now: Point) => set(turned(from, towards * (bearing(now) - bearing(start)))),
      },
    ];
  });
  return (
    <div class="gizmo" ref={first}>
      <svg aria-hidden="true" viewBox={`0 0 ${size.width} ${size.height}`}>
        {handles.map(({ kind, number, at }) => (
          <line key={`${kind}${number}`} class={`axis-${number}`} x1={middle[0]} y1={middle[1]} x2={at[0]} y2={at[1]} />
        ))}
      </svg>
      {handles.map(({ kind, number, at, label, nudge, move }) => (
        <Button
          key={`${kind}${number}`}

          class={`handle ${kind} axis-${number}`}
          aria-label={label}
          style={{ left: `${at[0]}px`, top: `${at[1]}px` }}
          onPointerDown={(event) => {
            event.currentTarget.setPointerCapture(event.pointerId);
            drag.current = { from: inside(event), motion };
          }}
          onPointerMove={(event) => {
            if (drag.current) move(drag.current.motion, drag.current.from, inside(event));
          }}
          onPointerUp={() => (drag.current = null)}
          onPointerCancel={() => (drag.current = null)}
          onKeyDown={(event) => {
            const sign = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
            if (!sign) return;
            event.preventDefault();
            nudge(sign * (event.shiftKey ? 5 : 1));
          }}
          text={AXIS_NAMES[number]}
        />
      ))}
    </div>
  );
}

export const AXIS_NAMES = ["x", "y", "z"] as const;

function inside(event: PointerEvent & { currentTarget: EventTarget }): Point {
  const frame = (event.currentTarget as HTMLElement).parentElement?.getBoundingClientRect();
  return [event.clientX - (frame?.left ?? 0), event.clientY - (frame?.top ?? 0)];
}
