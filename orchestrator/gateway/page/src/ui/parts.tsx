/** Small parts that all panels are made of. */

import type { ComponentChildren, JSX } from "preact";
import { useEffect, useId, useLayoutEffect, useRef } from "preact/hooks";
import { signal } from "@preact/signals";
import { noteOpen, stopKey } from "../core/keys.ts";
import { still } from "../core/many.ts";
import { showNote } from "../core/notices.ts";
import type { Level } from "../core/ready.ts";
import * as T from "../texts.ts";

/** A state's shape: what it means is never told by colour alone. */
export const MARK: Record<Level, string> = { ok: "○", busy: "▶", off: "◇", bad: "▲" };

interface PanelProps {
  title: string;
  area?: string;
  tools?: ComponentChildren;
  /** Long, with nothing in it that takes the focus: the keyboard scrolls the panel itself. */
  scrolls?: boolean;
  children: ComponentChildren;
}

export function Panel(props: PanelProps): JSX.Element {
  const id = useId();
  return (
    <section class={`panel ${props.area ?? ""}`} aria-labelledby={id}>
      <header>
        <h2 id={id}>{props.title}</h2>
        {props.tools}
      </header>
      <div class="body" {...(props.scrolls ? { tabIndex: 0, role: "group", "aria-labelledby": id } : {})}>
        {props.children}
      </div>
    </section>
  );
}

interface ActProps {
  label: string;
  onAct: () => void;
  /** Why it cannot be done now; empty: it can. */
  why?: string;
  /** It makes something move: the space bar does not press it. */
  motion?: boolean;
  kind?: "plain" | "strong" | "small";
  name?: string;
  title?: string;
  pressed?: boolean;
  /** It sends its form, as Enter in a field of it does. */
  submits?: boolean;
}

const swallowSpace = (event: KeyboardEvent): void => {
  if (event.key === " ") event.preventDefault();
};

/** A button. One that cannot be used now stays visible and says why, also to the keyboard. */
export function Act({ label, onAct, why = "", motion = false, kind = "plain", name, title, pressed, submits = false }: ActProps): JSX.Element {
  const space = motion ? { onKeyDown: swallowSpace, onKeyUp: swallowSpace } : {};
  return (
    <button
      type={submits && !why ? "submit" : "button"}
      class={`act ${kind}`}
      aria-label={name}
      aria-pressed={pressed}
      aria-disabled={why ? "true" : undefined}
      aria-description={why || undefined}
      title={why || title}
      {...space}
      onClick={() => (why ? showNote(T.why.cannot(name ?? label), why) : submits ? undefined : onAct())}
    >
      {label}
    </button>
  );
}

export function Field(props: { label: string; note?: string; children: ComponentChildren }): JSX.Element {
  return (
    <label class="field">
      <span>{props.label}</span>
      {props.children}
      {props.note ? <small>{props.note}</small> : null}
    </label>
  );
}

export function Mark({ level, text }: { level: Level; text: string }): JSX.Element {
  return (
    <span class={`mark ${level}`}>
      <span aria-hidden="true">{MARK[level]}</span> {text}
    </span>
  );
}

export function Empty({ text }: { text: string }): JSX.Element {
  return <p class="empty">{text}</p>;
}

export function Progress({ fraction, label }: { fraction: number; label: string }): JSX.Element {
  const whole = Math.round(Math.min(1, Math.max(0, fraction)) * 100);
  return (
    <div class="progress" role="progressbar" aria-label={label} aria-valuenow={whole} aria-valuemin={0} aria-valuemax={100}>
      <div style={{ width: `${whole}%` }} />
    </div>
  );
}

/** The open dialog. It leaves the stop bar free, and closes at Esc. A field with `data-first` has the focus at first. */
const dialog = signal<{ title: string; body: ComponentChildren; wide: boolean } | null>(null);
let opener: HTMLElement | null = null;

export function openDialog(title: string, body: ComponentChildren, wide = false): void {
  if (dialog.value === null && document.activeElement instanceof HTMLElement) opener = document.activeElement;
  still.value = true;
  dialog.value = { title, body, wide };
}

export function closeDialog(): void {
  if (dialog.value === null) return;
  dialog.value = null;
  still.value = false;
  opener?.focus();
  opener = null;
}

export function DialogHost(): JSX.Element | null {
  const now = dialog.value;
  const box = useRef<HTMLDivElement>(null);
  const id = useId();
  const isOpen = now !== null;
  useLayoutEffect(() => (isOpen ? noteOpen(closeDialog) : undefined), [isOpen]);
  useEffect(() => {
    if (now !== null) (box.current?.querySelector<HTMLElement>("[data-first]") ?? box.current)?.focus();
  }, [now?.title]);
  if (now === null) return null;
  return (
    <div class="veil" onPointerDown={(event) => (event.target === event.currentTarget ? closeDialog() : undefined)}>
      <div class={`dialog ${now.wide ? "wide" : ""}`} role="dialog" aria-labelledby={id} tabIndex={-1} ref={box}>
        <div class="head">
          <h2 id={id}>{now.title}</h2>
          <small>{T.keys.inDialog(T.keys.names(stopKey.value))}</small>
          <Act label={T.close} onAct={closeDialog} kind="small" />
        </div>
        <div class="body">{now.body}</div>
      </div>
    </div>
  );
}
