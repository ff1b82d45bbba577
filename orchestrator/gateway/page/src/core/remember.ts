/** What this browser remembers. */

import { effect, signal, type Signal } from "@preact/signals";

/** A signal whose value outlives the page. A browser that keeps nothing is no fault. */
export function remembered<V>(name: string, first: V, check: (value: unknown) => value is V): Signal<V> {
  const key = `tutti.${name}`;
  let value = first;
  try {
    const read: unknown = JSON.parse(localStorage.getItem(key) ?? "null");
    if (check(read)) value = read;
  } catch {
    // nothing was kept
  }
  const kept = signal(value);
  effect(() => {
    const text = JSON.stringify(kept.value);
    try {
      localStorage.setItem(key, text);
    } catch {
      // nothing can be kept
    }
  });
  return kept;
}

export const isText = (value: unknown): value is string => typeof value === "string";
export const isNumber = (value: unknown): value is number => typeof value === "number";
export const isFlag = (value: unknown): value is boolean => typeof value === "boolean";
export const isTexts = (value: unknown): value is string[] => Array.isArray(value) && value.every(isText);
