/** The keep-out zones of the fleet: where bodies are, and what each rule says. Asked for often only while they are shown. */

import { effect, signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { poll } from "./poll.ts";
import { connection } from "./stream.ts";

export type Vector = [number, number, number];
export type Spot = [number, number];

/** A convex body in the machine's frame, mm: the hull of its corners; of a sphere, `radius` around one corner. */
export interface Outline {
  corners: Vector[];
  edges?: [number, number][];
  radius?: number;
  certain?: boolean;
  description?: string;
}

export interface ZoneRule {
  rule: string;
  bodies?: string[];
  holds: boolean | null;
  distance?: number | null;
  least?: number | null;
  text: string;
}

export interface ZoneState {
  bodies?: Record<string, Outline>;
  regions?: Record<string, Outline>;
  rules?: ZoneRule[];
  ways?: Record<string, Vector>;
}

const SHOWN_MS = 500;
const HIDDEN_MS = 5000;

export const zones = signal<ZoneState | null>(null);
const viewers = signal(0);

/** Ask often while a component that shows them is there. */
export function useZones(): ZoneState | null {
  useEffect(() => {
    viewers.value += 1;
    return () => void (viewers.value -= 1);
  }, []);
  return zones.value;
}

/** A fleet without zones is asked once for each connection. */
export function watchZones(): void {
  effect(() => {
    if (connection.value !== "open") return undefined;
    return poll<ZoneState>("zones", viewers.value > 0 ? SHOWN_MS : HIDDEN_MS, (answer) => {
      zones.value = answer;
      return !answer.rules?.length;
    });
  });
}

/** Whether a rule is broken that names a body or a region. */
export function isBroken(state: ZoneState, name: string): boolean {
  return !!state.rules?.some((rule) => rule.holds === false && (rule.rule === name || rule.bodies?.includes(name)));
}

export function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** The corners of the convex hull of points, in order (Andrew's monotone chain, 1979). */
export function hullOf(spots: Spot[]): Spot[] {
  const ordered = [...spots].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const walk = (points: Spot[]): Spot[] => {
    const chain: Spot[] = [];
    for (const point of points) {
      for (let a = chain.at(-2), b = chain.at(-1); a && b; a = chain.at(-2), b = chain.at(-1)) {
        if ((b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) > 0) break;
        chain.pop();
      }
      chain.push(point);
    }
    return chain.slice(0, -1);
  };
  return [...walk(ordered), ...walk(ordered.reverse())];
}

const ROUND = 32; // corners of a sphere's outline

/** Corners of the outline of a body, seen along `right` and `up`. */
export function seenFrom(outline: Outline, right: Vector, up: Vector): Spot[] {
  const spots = outline.corners.map((corner): Spot => [dot(corner, right), dot(corner, up)]);
  const [middle] = spots;
  const radius = outline.radius;
  if (!radius || !middle) return hullOf(spots);
  return Array.from({ length: ROUND }, (_, n): Spot => {
    const angle = (2 * Math.PI * n) / ROUND;
    return [middle[0] + radius * Math.cos(angle), middle[1] + radius * Math.sin(angle)];
  });
}
