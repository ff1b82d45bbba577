/** Messages that stay until they are dismissed: refusals, stops with their user, results. */

import { signal } from "@preact/signals";
import type { Answer, Refusal } from "./model.ts";

export interface Notice {
  key: number;
  kind: "refusal" | "note";
  title: string;
  text: string;
  remedy: string;
  code: string;
  controller: string;
  count: number;
  /** It comes before everything else: a user has to act now. */
  urgent: boolean;
}

const MOST = 6;

export const notices = signal<Notice[]>([]);
let lastKey = 0;

export function showRefusal(what: string, refusal: Refusal, urgent = false): void {
  add({
    kind: "refusal",
    title: what,
    text: refusal.text,
    remedy: refusal.remedy ?? "",
    code: refusal.code,
    controller: refusal.controller ?? refusal.member ?? "",
    urgent,
  });
}

export function showNote(title: string, text = ""): void {
  add({ kind: "note", title, text, remedy: "", code: "", controller: "", urgent: false });
}

/** The result of `answer`, or null after its refusal has been shown. */
export function accept<R>(what: string, answer: Answer<R>): R | null {
  if ("ok" in answer) return answer.ok;
  showRefusal(what, answer.refused);
  return null;
}

export function dismiss(key: number): void {
  notices.value = notices.value.filter((notice) => notice.key !== key);
}

function add(notice: Omit<Notice, "key" | "count">): void {
  const same = notices.value.find((each) => each.title === notice.title && each.text === notice.text);
  const rest = notices.value.filter((each) => each !== same);
  lastKey += 1;
  notices.value = [{ ...notice, key: lastKey, count: (same?.count ?? 0) + 1 }, ...rest].slice(0, MOST);
}
