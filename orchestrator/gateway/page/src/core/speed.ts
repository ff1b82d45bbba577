/** The speed of a move as people write it: `5 mm/s`, `50 %`, `0.5`. What is allowed is decided by the fleet. */

import { formatUnit } from "./format.ts";
import type { AxisState } from "./model.ts";
import * as T from "../texts.ts";

const MANUAL = 0.2; // of an axis whose fleet file is not known to the gateway

export interface Speed {
  /** As a step of a job has it: a fraction of the limit, or a speed with its unit. */
  value: number | string;
  /** Unit/s; null: only the fleet can convert it. */
  rate: number | null;
}

/** The speed that a move begins with: that of the axis for what a person asks for. */
export function manualSpeed(axis: AxisState): string {
  return `${Number(((axis.manual_speed ?? MANUAL) * 100).toPrecision(6))} %`;
}

/** A speed from its text, or why it is none. */
export function readSpeed(text: string, axis: AxisState): Speed | string {
  const [, digits = "", unit = ""] = /^\s*\+?(\d+[.,]?\d*|[.,]\d+)\s*([^\d\s.,]\S*)?\s*$/.exec(text) ?? [];
  if (digits === "") return T.speed.unread(example(axis));
  const number = Number(digits.replace(",", "."));
  const limit = axis.max_velocity;
  if (unit === "" || unit === "%") {
    const part = unit === "%" ? number / 100 : number;
    if (!(part > 0 && part <= 1)) return unit === "%" ? T.speed.outside : T.speed.noUnit(text.trim(), `${digits} ${formatUnit(axis.unit)}/s`);
    return { value: Number(part.toPrecision(9)), rate: limit === undefined ? null : part * limit };
  }
  if (number <= 0) return T.speed.zero;
  const plain = unit.replaceAll("µ", "u").replaceAll("°", "deg");
  const own = plain === `${axis.unit}/s`;
  if (own && limit !== undefined && number > limit) return T.speed.above(`${Number(limit.toPrecision(6))} ${formatUnit(axis.unit)}/s`);
  return { value: `${number} ${plain}`, rate: own ? number : null };
}

function example(axis: AxisState): string {
  return `5 ${formatUnit(axis.unit)}/s`;
}
