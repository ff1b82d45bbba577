/** The menu of one axis: what must not sit beside the keys that move it, with its value written out. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { formatQuantity, formatUnit, readNumber } from "../core/format.ts";
import { beginWork, working } from "../core/manual.ts";
import { readinessOf } from "../core/ready.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { permits, type AxisStore, type ControllerStore } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, closeDialog, Field, Mark } from "./parts.tsx";

export function AxisMenu({ axis, controller }: { axis: AxisStore; controller: ControllerStore }): JSX.Element {
  const { of } = controller.rest.value;
  const axes = of ?? [axis.id];
  const flags = axis.flags.value;
  const why = firstOf(whyNot("work", controller.id), working.value ? T.why.working(working.value.words) : "");
  const work = (words: string, step: object): void => {
    void beginWork(words, axes, step);
    closeDialog();
  };
  return (
    <div class="menu">
      <p>
        {T.axes.now}: <b class="num">{formatQuantity(axis.position.value, flags.unit)}</b>{" "}
        {flags.offset && flags.offset !== "0" ? T.axes.offset(flags.offset) : ""}
      </p>
      <ReadyLine axis={axis} controller={controller} />
      <div class="row">
        {flags.enabled ? (
          <Act label={T.axes.disable(axis.id)} why={why} onAct={() => work(T.axes.disable(axis.id), { do: "disable", axes })} />
        ) : (
          <Act label={T.axes.enable(axis.id)} why={why} motion onAct={() => work(T.axes.enable(axis.id), { do: "enable", axes })} />
        )}
      </div>
      <div class="row">
        <Act label={T.axes.home(axis.id)} why={why} motion onAct={() => work(T.axes.home(axis.id), { do: "home", axes })} />
        <span class="hint">{T.axes.homeHint}</span>
      </div>
      {of ? <p class="hint">{T.axes.standsFor(of.join(", "))}</p> : <SetPosition axis={axis} why={why} work={work} />}
    </div>
  );
}

interface SetProps {
  axis: AxisStore;
  why: string;
  work: (words: string, step: object) => void;
}

/** What the present position is called. Virtual axes have no offset: they follow from their real ones. */
function SetPosition({ axis, why, work }: SetProps): JSX.Element {
  const [text, setText] = useState("");
  const flags = axis.flags.value;
  const unit = formatUnit(flags.unit);
  const value = readNumber(text);
  const valueWhy = firstOf(why, value === null ? T.axes.typeNumber : "");
  return (
    <>
      <Field label={T.axes.valueLabel(unit)}>
        <input
          type="text"
          inputMode="decimal"
          value={text}
          aria-label={T.axes.valueLabel(unit)}
          onInput={(event) => setText(event.currentTarget.value)}
        />
      </Field>
      <div class="row">
        <Act
          label={T.axes.setTo(value === null ? "…" : formatQuantity(value, flags.unit))}
          why={valueWhy}
          onAct={() => work(T.axes.setting(axis.id), { do: "set-position", axes: { [axis.id]: value } })}
        />
        <Act
          label={T.axes.removeOffset}
          why={why}
          onAct={() => work(T.axes.setting(axis.id), { do: "set-position", axes: { [axis.id]: null } })}
        />
      </div>
      <p class="hint">{T.axes.setHint}</p>
    </>
  );
}

/** Why an axis is not ready, with what to do; nothing for one that is. */
export function ReadyLine({ axis, controller }: { axis: AxisStore; controller: ControllerStore }): JSX.Element | null {
  const ready = readinessOf(axis.id, axis.flags.value, controller.rest.value, permits.value);
  if (!ready.remedy) return null;
  return (
    <p>
      <Mark level={ready.level} text={ready.text} /> <small class="remedy">{ready.remedy}</small>
    </p>
  );
}
