/** Numbers and times as text, with as many places as the unit makes sense of, so that their widths do not change. */

import { onPage } from "../texts.ts";

const PLACES: Record<string, number> = {
  m: 6,
  cm: 4,
  mm: 3,
  um: 1,
  nm: 0,
  in: 4,
  deg: 3,
  arcmin: 2,
  arcsec: 1,
  rad: 5,
  mrad: 3,
  rev: 4,
  counts: 0,
};

export function placesOf(unit: string): number {
  return PLACES[unit] ?? 3;
}

export function formatValue(value: number | null | undefined, unit: string): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(placesOf(unit));
  return Number(text) === 0 ? text.replace("-", "") : text;
}

export function formatUnit(unit: string): string {
  return unit === "um" ? "µm" : unit === "deg" ? "°" : unit;
}

export function formatQuantity(value: number | null | undefined, unit: string): string {
  return `${formatValue(value, unit)} ${formatUnit(unit)}`;
}

/** A plain number for a request, without an exponent or superfluous zeros. */
export function plainNumber(value: number): string {
  return String(Number(value.toFixed(9)));
}

/** Nanoseconds in a unit that fits. */
export function formatNs(ns: number | null | undefined): string {
  if (ns === null || ns === undefined) return "–";
  const size = Math.abs(ns);
  if (size < 1e3) return `${ns.toFixed(0)} ns`;
  if (size < 1e6) return `${(ns / 1e3).toFixed(size < 1e4 ? 1 : 0)} µs`;
  if (size < 1e9) return `${(ns / 1e6).toFixed(size < 1e7 ? 2 : 1)} ms`;
  return `${(ns / 1e9).toFixed(2)} s`;
}

export function formatSeconds(seconds: number | null | undefined): string {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor((whole % 3600) / 60), whole % 60];
  const two = (n: number): string => String(n).padStart(2, "0");
  return h > 0 ? `${h}:${two(m)}:${two(s)} h` : `${m}:${two(s)} min`;
}

export function formatBytes(bytes: number | null | undefined): string {
  if (bytes === null || bytes === undefined) return "–";
  if (bytes < 10_000) return `${bytes} B`;
  if (bytes < 10_000_000) return `${(bytes / 1000).toFixed(1)} kB`;
  return `${(bytes / 1e6).toFixed(1)} MB`;
}

/** The time of day of an RFC 3339 instant, in UTC, as it was sent: nothing of this device's clock comes in. */
export function timeOfDay(utc: string | null | undefined): string {
  return utc ? utc.slice(11, 19) : "–";
}

export function dayAndTime(utc: string | null | undefined): string {
  return utc ? `${utc.slice(0, 10)} ${utc.slice(11, 19)}` : "–";
}

export function shortId(id: string): string {
  return id.length > 8 ? id.slice(0, 8) : id;
}

export function percent(fraction: number): string {
  return `${Math.round(fraction * 100)} %`;
}

/** A user without the address behind the name; where there is room, the whole is shown. */
export function withoutAddress(actor: string): string {
  return actor.replace(/@[^@]*$/, "");
}

/** Why not, and what to do, as one sentence; with the controller that refuses before it. */
export function explain(problem: { text: string; remedy?: string; controller?: string | null; member?: string | null }): string {
  const source = problem.controller ?? problem.member;
  const text = source && !problem.text.startsWith(source) ? `${source}: ${problem.text}` : problem.text;
  if (!problem.remedy) return onPage(text);
  return onPage(/[.!?;:]$/.test(text) ? `${text} ${problem.remedy}` : `${text}; ${problem.remedy}`);
}

/** A number as people write it, with a comma or a point; null for anything else. */
export function readNumber(text: string): number | null {
  const plain = text.trim().replace(",", ".").replace(/^[−–]/, "-");
  if (!/^[+-]?(\d+\.?\d*|\.\d+)$/.test(plain)) return null;
  return Number(plain);
}
