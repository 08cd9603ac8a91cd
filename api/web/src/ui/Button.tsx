import type { ComponentProps } from "preact";

type Properties = Omit<ComponentProps<"button">, "children" | "ref"> & { text: string | undefined };

/** A button with a text; it sends no form unless its type says so. */
export function Button({ text, type = "button", ...more }: Properties) {
  return (
    <button type={type} {...more}>
      {text}
    </button>
  );
}
