import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";

import type { IconName } from "./Icon";
import { Icon } from "./Icon";

interface TabOf<Name extends string> {
  name: Name & IconName;
  title: string;
  /** How many there are behind it, once that is known. */
  count?: number | undefined;
  content: ComponentChildren;
}

interface Properties<Name extends string> {
  label: string;
  tabs: readonly TabOf<Name>[];
  active: Name;
  onSelect: (name: Name) => void;
  /** Between the row of tabs and what is behind them. */
  children?: ComponentChildren;
}

/** Tabs by the keyboard's usual keys. What is behind one is made when it is first opened, and kept. */
export function Tabs<Name extends string>({ label, tabs, active, onSelect, children }: Properties<Name>) {
  const [opened, setOpened] = useState<ReadonlySet<string>>(new Set([active]));
  const list = useRef<HTMLDivElement>(null);
  if (!opened.has(active)) setOpened(new Set([...opened, active]));
  useEffect(() => {
    // A long tab was scrolled down: the next one begins at its beginning.
    const [row, scrolled] = [list.current, list.current?.parentElement];
    if (row && scrolled && scrolled.scrollTop > row.offsetTop) scrolled.scrollTop = row.offsetTop;
  }, [active]);
  const step = (event: KeyboardEvent) => {
    const at = tabs.findIndex((tab) => tab.name === active);
    const to = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    const next = tabs[(to + tabs.length) % tabs.length];
    if (!next) return;
    onSelect(next.name);
    list.current?.querySelector<HTMLElement>(`#tab-${next.name}`)?.focus();
  };
  return (
    <>
      <div class="tabs" role="tablist" aria-label={label} ref={list} onKeyDown={step}>
        {tabs.map(({ name, title, count }) => (
          <button
            key={name}
            type="button"
            role="tab"
            id={`tab-${name}`}
            aria-controls={`behind-${name}`}
            aria-selected={name === active}
            tabIndex={name === active ? 0 : -1}
            onClick={() => onSelect(name)}
          >
            <Icon name={name} />
            <span>
              {title} {count !== undefined && <span class="count">{count}</span>}
            </span>
          </button>
        ))}
      </div>
      {children}
      {tabs.map(({ name, content }) => (
        <div
          key={name}
          class="tab-body"
          role="tabpanel"
          id={`behind-${name}`}
          aria-labelledby={`tab-${name}`}
          hidden={name !== active}
        >
          {(opened.has(name) || name === active) && content}
        </div>
      ))}
    </>
  );
}
