/** Drawings of 24 × 24, as strokes: see `Icon`. */
const PATHS = {
  ask: "M10.5 4a6.5 6.5 0 1 0 0 13 6.5 6.5 0 0 0 0-13ZM15.3 15.3 20 20",
  objects: "M12 3 20 7.5v9L12 21l-8-4.5v-9L12 3ZM4 7.5 12 12l8-4.5M12 12v9",
  photos: "M4 6h16v13H4V6ZM4 16l4.5-4.5 4 4L16 12l4 4M15.5 9.3v.2",
  share: "M12 15V4M8 7.5 12 3.5l4 4M5 12v8h14v-8",
  undo: "M8 5 4 9l4 4M4 9h10a5.5 5.5 0 0 1 0 11h-3",
  redo: "M16 5l4 4-4 4M20 9H10a5.5 5.5 0 0 0 0 11h3",
  home: "M4 11.5 12 4l8 7.5M6.5 9.5V20h11V9.5",
  measure: "M3 16 16 3l5 5L8 21l-5-5ZM7 12l2 2M10 9l3 3M13 6l2 2",
  help: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18ZM9.5 9.5a2.5 2.5 0 1 1 3.6 2.2c-.8.4-1.1.9-1.1 1.8M12 16.5v.2",
  colors: "M12 3.5c4 4.5 6 7.3 6 10a6 6 0 0 1-12 0c0-2.7 2-5.5 6-10ZM12 16.5a3 3 0 0 0 3-3",
  here: "M5 12.5 10 17.5 19.5 7",
  maybe: "M4 14c2.5-4 5.5-4 8-2s5.5 2 8-2",
  absent: "M6 6l12 12M18 6 6 18",
  unseen: "M3 12c3-4.5 6-6.5 9-6.5s6 2 9 6.5c-3 4.5-6 6.5-9 6.5S6 16.5 3 12ZM5 20 19 4",
  plus: "M12 5v14M5 12h14",
} as const;

export type IconName = keyof typeof PATHS;

/** A drawing beside a text that says the same. */
export function Icon({ name }: { name: IconName }) {
  return (
    <svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
      <path d={PATHS[name]} />
    </svg>
  );
}
