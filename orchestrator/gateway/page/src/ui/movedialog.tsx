/** Move one axis: to a value, or by a step, at a speed that begins at the axis's own for what a person asks for. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { formatQuantity, formatUnit, plainNumber, readNumber } from "../core/format.ts";
import { whyBeyond } from "../core/limits.ts";
import { beginWork, working } from "../core/manual.ts";
import { isNumber, remembered } from "../core/remember.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { manualSpeed, readSpeed } from "../core/speed.ts";
import type { AxisStore, ControllerStore } from "../core/store.ts";
import * as T from "../texts.ts";
import { ReadyLine } from "./axismenu.tsx";
import { STEPS, WorkLine } from "./jogpad.tsx";
import { Act, closeDialog, Field } from "./parts.tsx";

const FIRST_STEP = 1;
const stepSize = remembered("move.step", FIRST_STEP, isNumber);

export function MoveDialog({ axis, controller }: { axis: AxisStore; controller: ControllerStore }): JSX.Element {
  const [text, setText] = useState("");
  const [speedText, setSpeedText] = useState(manualSpeed(axis.flags.value));
  const flags = axis.flags.value;
  const unit = formatUnit(flags.unit);
  const speed = readSpeed(speedText, flags);
  const speedWhy = typeof speed === "string" ? speed : "";
  const why = firstOf(whyNot("work", controller.id), working.value ? T.why.working(working.value.words) : "", speedWhy);
  const value = readNumber(text);
  const beyond = whyBeyond(axis, value);
  const goWhy = firstOf(why, value === null ? T.axes.typeNumber : "", beyond);
  const move = (target: object): Promise<boolean> =>
    beginWork(T.axes.moving(axis.id), [axis.id], { do: "move", ...target, ...(typeof speed === "string" ? {} : { speed: speed.value }) });
  const go = (): void => {
    void move({ to: { [axis.id]: value } });
    closeDialog();
  };
  return (
    <div class="menu">
      <p class="facts num">
        <span>
          {T.axes.now}: <b>{formatQuantity(axis.position.value, flags.unit)}</b>
        </span>
        <span>{limitsOf(axis)}</span>
      </p>
      <ReadyLine axis={axis} controller={controller} />
      <form
        class="moveform"
        onSubmit={(event) => {
          event.preventDefault();
          if (goWhy === "") go();
        }}
      >
        <Field label={T.axes.valueLabel(unit)}>
          <input type="text" inputMode="decimal" data-first value={text} onInput={(event) => setText(event.currentTarget.value)} />
        </Field>
        <Field label={T.speed.label}>
          <input type="text" value={speedText} onInput={(event) => setSpeedText(event.currentTarget.value)} />
        </Field>
        <Act
          label={T.axes.goTo(value === null ? "…" : formatQuantity(value, flags.unit))}
          kind="strong"
          motion
          submits
          why={goWhy}
          onAct={go}
        />
      </form>
      {beyond ? <p class="reason bad">{`▲ ${beyond}`}</p> : null}
      {typeof speed === "string" ? <p class="reason bad">{`▲ ${speed}`}</p> : <p class="hint num">{T.speed.means(speed.rate === null ? speedText : `${formatQuantity(speed.rate, flags.unit)}/s`)}</p>}
      <div class="row by">
        <StepAct axis={axis} sign={-1} why={why} onStep={move} />
        <select aria-label={T.axes.stepLabel(axis.id)} value={stepSize.value} onChange={(event) => (stepSize.value = Number(event.currentTarget.value))}>
          {STEPS.map((step) => (
            <option key={step} value={step}>{`${step} ${unit}`}</option>
          ))}
        </select>
        <StepAct axis={axis} sign={1} why={why} onStep={move} />
        <span class="hint">{T.axes.stepHint}</span>
      </div>
      <WorkLine />
    </div>
  );
}

/** One step from where the axis stands. The dialog stays open: the next press is the next step. */
function StepAct(props: { axis: AxisStore; sign: number; why: string; onStep: (target: object) => Promise<boolean> }): JSX.Element {
  const { axis, sign } = props;
  const { unit, referenced } = axis.flags.value;
  const distance = sign * stepSize.value;
  const beyond = referenced && axis.position.value !== null ? whyBeyond(axis, axis.position.value + distance) : "";
  return (
    <Act
      label={sign > 0 ? "+" : "−"}
      name={T.axes.stepBy(axis.id, `${sign > 0 ? "+" : "−"}${stepSize.value} ${formatUnit(unit)}`)}
      motion
      why={firstOf(props.why, beyond)}
      onAct={() => void props.onStep({ by: { [axis.id]: Number(plainNumber(distance)) } })}
    />
  );
}

function limitsOf(axis: AxisStore): string {
  const { min, max, unit } = axis.flags.value;
  if (min === undefined && max === undefined) return T.axes.noLimits;
  return T.axes.limits(formatQuantity(min, unit), formatQuantity(max, unit));
}
