/** Targets beyond soft limits, named before anything is asked. */

import { formatQuantity, formatUnit } from "./format.ts";
import { findAxis, type AxisStore } from "./store.ts";
import * as T from "../texts.ts";

/** Why a position is no target of an axis; empty: it is one, as far as this page knows. */
export function whyBeyond(axis: AxisStore, value: number | null): string {
  const { min, max, unit } = axis.flags.value;
  if (value === null) return "";
  if (max !== undefined && value > max) return T.axes.beyond(axis.id, formatQuantity(value, unit), formatQuantity(max, unit));
  if (min !== undefined && value < min) return T.axes.beyond(axis.id, formatQuantity(value, unit), formatQuantity(min, unit));
  return "";
}

/** The same of positions in a list: numbers, or texts with the axis's unit. Other units the fleet converts and checks. */
export function whyBeyondOf(axes: Record<string, string | number>): string[] {
  return Object.entries(axes)
    .map(([id, value]) => {
      const axis = findAxis(id);
      return axis ? whyBeyond(axis, numberOf(value, axis.flags.value.unit)) : "";
    })
    .filter(Boolean);
}

function numberOf(value: string | number, unit: string): number | null {
  if (typeof value === "number") return value;
  const [, digits = "", named = ""] = /^\s*([+-]?(?:\d+\.?\d*|\.\d+))\s*(\S*)\s*$/.exec(value) ?? [];
  return digits !== "" && (named === "" || named === unit || named === formatUnit(unit)) ? Number(digits) : null;
}
