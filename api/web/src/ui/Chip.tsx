import type { ComponentChildren } from "preact";

/** A small button in a row of others: what it offers, of which two lines are shown, and what stands before and behind it. */
export function Chip({
  label,
  before,
  behind,
  disabled = false,
  onClick,
  children,
}: {
  /** What it is called, where that is more than what it shows. */
  label?: string;
  before?: ComponentChildren;
  behind?: ComponentChildren;
  disabled?: boolean;
  onClick: () => void;
  children: ComponentChildren;
}) {
  return (
    <li>
      <button type="button" class="chip" aria-label={label} disabled={disabled} onClick={onClick}>
        {before}
        <span>{children}</span> {behind}
      </button>
    </li>
  );
}
