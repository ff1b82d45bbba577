/** Get ready: the axes that jobs need are enabled and homed, after one confirmation that lists them. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { computed } from "@preact/signals";
import { get } from "../core/http.ts";
import { isMany, wanted } from "../core/many.ts";
import { beginWork, working } from "../core/manual.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { realAxes } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, closeDialog, Empty, openDialog } from "./parts.tsx";

/** The axes whose motor is off, or whose reference is missing. */
export const unready = computed(() => realAxes().filter((axis) => !axis.flags.value.enabled || !axis.flags.value.referenced));
/** Of many controllers it is not known. */
export const mayBeUnready = computed(() => isMany.value || unready.value.length > 0);

const MOST_JOBS = 20;

/** ids: of the jobs that have to be able to begin; none: all axes of the fleet. */
export function GetReady({ ids }: { ids: string[] }): JSX.Element {
  return (
    <Act
      label={T.ready.get}
      kind="small"
      why={firstOf(whyNot("work"), working.value ? T.why.working(working.value.words) : "")}
      onAct={() => openDialog(T.ready.title, <ReadyDialog ids={ids.slice(0, MOST_JOBS)} />)}
    />
  );
}

function ReadyDialog({ ids }: { ids: string[] }): JSX.Element {
  const [names, setNames] = useState<string[] | null>(ids.length === 0 ? realAxes().map((axis) => axis.id) : null);
  useEffect(() => {
    if (ids.length > 0) void findNeeded(ids).then(setNames);
    return () => void (wanted.value = []);
  }, [ids.join()]);
  // Of many controllers those of a job are loaded first.
  useEffect(() => void (wanted.value = isMany.value ? (names ?? []) : []), [names]);
  const axes = realAxes().filter((axis) => names?.includes(axis.id));
  if (names === null || (isMany.value && axes.length < names.length)) return <Empty text={T.loading} />;
  const off = axes.filter((axis) => !axis.flags.value.enabled).map((axis) => axis.id);
  const lost = axes.filter((axis) => !axis.flags.value.referenced).map((axis) => axis.id);
  const owners = [...new Set(axes.map((axis) => axis.controller))];
  const why = firstOf(
    ...owners.map((owner) => whyNot("work", owner)),
    working.value ? T.why.working(working.value.words) : "",
    off.length + lost.length === 0 ? T.ready.allReady : "",
  );
  const steps = [...(off.length > 0 ? [{ do: "enable", axes: off }] : []), ...(lost.length > 0 ? [{ do: "home", axes: lost }] : [])];
  const confirm = (): void => {
    closeDialog();
    void beginWork(T.ready.title, [...new Set([...off, ...lost])], steps);
  };
  return (
    <div class="menu">
      {off.length > 0 ? <p>{T.ready.toEnable(off.join(", "))}</p> : null}
      {lost.length > 0 ? <p>{T.ready.toHome(lost.join(", "))}</p> : null}
      {lost.length > 0 ? <p class="hint">{T.ready.homeHint}</p> : null}
      {off.length + lost.length === 0 ? <Empty text={T.ready.allReady} /> : null}
      {why && off.length + lost.length > 0 ? <p class="reason bad">{`▲ ${why}`}</p> : null}
      <div class="row finish">
        <Act label={T.ready.confirm(off.length > 0, lost.length > 0)} kind="strong" motion why={why} onAct={confirm} />
        <Act label={T.start.cancel} onAct={closeDialog} />
      </div>
    </div>
  );
}

/** The axes that these jobs use, those of their named positions too. Of a job that cannot be told: all axes. */
async function findNeeded(ids: string[]): Promise<string[]> {
  const answers = await Promise.all(ids.map((id) => get<{ axes: string[] }>(`jobs/${encodeURIComponent(id)}/axes`)));
  const all = realAxes();
  return [...new Set(answers.flatMap((answer) => ("ok" in answer ? answer.ok.axes : all.map((axis) => axis.id))))];
}
