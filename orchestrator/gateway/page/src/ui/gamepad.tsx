/** The gamepad of the jog pad: off until it is switched on, with what its sticks and buttons do. */

import type { JSX } from "preact";
import { useEffect } from "preact/hooks";
import type { Signal } from "@preact/signals";
import { percent } from "../core/format.ts";
import { DEAD_ZONES, deadMan, deadZone, hasGamepads, isArmed, MOST_INPUTS, padOn, reading, reversed, setDrives, sticks, switchOff, switchOn, type Drive, type PadReading, type Way } from "../core/gamepad.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import * as T from "../texts.ts";
import { Act, Empty, Field, Mark } from "./parts.tsx";

/** With its velocity in words, at a part of the deflection. */
export interface AxisDrive extends Drive {
  show(part: number): string;
}

type Drives = Record<Way, AxisDrive | undefined>;
const WAYS: Way[] = ["across", "upwards"];

export function GamepadForm(drives: Drives): JSX.Element {
  const { across, upwards } = drives;
  setDrives({ ...(across ? { across } : {}), ...(upwards ? { upwards } : {}) });
  // What moves stays in sight: another view has no jog pad.
  useEffect(() => switchOff, []);
  const now = reading.value;
  const why = firstOf(whyNot("jog"), hasGamepads() ? "" : T.pad.noApi);
  return (
    <fieldset class="choice gamepad" aria-label={T.pad.title}>
      <legend>{T.pad.title}</legend>
      <Act label={T.pad.use} kind="small" pressed={padOn.value} why={padOn.value ? "" : why} onAct={() => (padOn.value ? switchOff() : switchOn())} />
      {padOn.value && now === null ? <Empty text={T.pad.none} /> : null}
      {padOn.value && now !== null ? <PadSettings now={now} drives={drives} /> : null}
    </fieldset>
  );
}

function PadSettings({ now, drives }: { now: PadReading; drives: Drives }): JSX.Element {
  return (
    <div class="padform">
      <p class="quiet">{now.name}</p>
      <p role="status" aria-label={T.pad.title}>
        {isArmed.value ? <Mark level="busy" text={T.pad.armed} /> : <Mark level="off" text={now.held ? T.pad.held : T.pad.loose} />}
        {now.pressed === null ? null : <span class="hint">{` · ${T.pad.pressed(now.pressed)}`}</span>}
      </p>
      <div class="padgrid">
        <InputSelect label={T.pad.deadMan} chosen={deadMan} count={now.buttons} name={T.pad.button} />
        <Field label={T.pad.deadZone}>
          <select value={deadZone.value} onChange={(event) => change(() => (deadZone.value = Number(event.currentTarget.value)))}>
            {DEAD_ZONES.map((zone) => (
              <option key={zone} value={zone}>
                {percent(zone)}
              </option>
            ))}
          </select>
        </Field>
        {WAYS.map((way) => (
          <div key={way}>
            <InputSelect label={T.pad.stick[way]} chosen={sticks[way]} count={now.axes} name={T.pad.axis} />
            <label class="check">
              <input type="checkbox" aria-label={`${T.pad.stick[way]}, ${T.pad.reversed}`} checked={reversed[way].value} onChange={(event) => change(() => (reversed[way].value = event.currentTarget.checked))} />
              {T.pad.reversed}
            </label>
            <StickBar part={now.parts[way]} label={T.pad.now[way]} />
            {drives[way] ? <small class="num quiet">{T.pad.drives(drives[way].axis, drives[way].show(now.parts[way]))}</small> : null}
          </div>
        ))}
      </div>
      {WAYS.map((way) => (drives[way] ? <p class="hint" key={way}>{T.pad.scale(drives[way].axis, drives[way].show(1))}</p> : null))}
      <p class="hint">{T.pad.hint}</p>
    </div>
  );
}

/** What a stick does is changed only while it does nothing. */
function change(set: () => void): void {
  isArmed.value = false;
  set();
}

function InputSelect(props: { label: string; chosen: Signal<number>; count: number; name: (number: number) => string }): JSX.Element {
  const { label, chosen, count, name } = props;
  // A choice that this pad does not have stays visible: it is the reason why nothing moves.
  const numbers = Array.from({ length: Math.min(MOST_INPUTS, Math.max(count, chosen.value + 1)) }, (_, number) => number);
  return (
    <Field label={label}>
      <select value={chosen.value} onChange={(event) => change(() => (chosen.value = Number(event.currentTarget.value)))}>
        {numbers.map((number) => (
          <option key={number} value={number}>
            {number < count ? name(number) : T.pad.missing(name(number))}
          </option>
        ))}
      </select>
    </Field>
  );
}

function StickBar({ part, label }: { part: number; label: string }): JSX.Element {
  return (
    <div class="track stick" role="meter" aria-label={label} aria-valuemin={-100} aria-valuemax={100} aria-valuenow={Math.round(part * 100)}>
      <div class="needle" style={{ left: `${(part + 1) * 50}%` }} />
    </div>
  );
}
