/** Alarms: what is wrong, what to do; acknowledged and shelved one by one, each cause by itself. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { isSetAside, newAlarms, sortedAlarms } from "../core/alarms.ts";
import { dayAndTime } from "../core/format.ts";
import { post } from "../core/http.ts";
import { isFlag, remembered } from "../core/remember.ts";
import type { Alarm } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { whyNot } from "../core/rights.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, Empty, Panel } from "./parts.tsx";

const showAside = remembered("alarms.aside", true, isFlag);

export function AlarmsPanel(): JSX.Element {
  return (
    <Panel title={T.alarms.title} area="alarms">
      <AlarmList />
    </Panel>
  );
}

export function AlarmList(): JSX.Element {
  const aside = sortedAlarms.value.filter(isSetAside);
  const fresh = newAlarms.value.map((alarm) => alarm.id);
  const shown = showAside.value ? sortedAlarms.value : sortedAlarms.value.filter((alarm) => !isSetAside(alarm));
  return (
    <>
      {aside.length > 0 ? (
        <label class="check">
          <input type="checkbox" checked={showAside.value} onChange={(event) => (showAside.value = event.currentTarget.checked)} />
          {T.alarms.showAside(aside.length)}
        </label>
      ) : null}
      {fresh.length > 1 ? (
        <div class="row">
          <Act label={T.alarms.acknowledgeAll(fresh.length)} kind="small" why={whyNot("acknowledge")} onAct={() => void acknowledge(fresh)} />
        </div>
      ) : null}
      {shown.length === 0 ? <Empty text={T.alarms.none} /> : null}
      <ul class="cards" aria-label={T.alarms.title}>
        {shown.map((alarm) => (
          <AlarmCard key={alarm.id} alarm={alarm} />
        ))}
      </ul>
    </>
  );
}

function AlarmCard({ alarm }: { alarm: Alarm }): JSX.Element {
  const aside = isSetAside(alarm);
  const fresh = alarm.state === "unacknowledged" || alarm.state === "returned";
  return (
    <li class={`card alarm ${aside ? "aside" : alarm.priority} ${fresh && !aside ? "fresh" : ""}`} data-alarm={alarm.id}>
      <div class="cardtext">
        <div class="rowhead">
          <span aria-hidden="true">{aside ? "◌" : fresh ? "▲" : "△"}</span> <b>{alarm.subject}</b> <span>{T.alarms.priority(alarm.priority)}</span>
          <span class="quiet">{T.alarms.state[alarm.state]}</span>
        </div>
        <p>{onPage(alarm.text)}</p>
        {alarm.action ? <p class="remedy">{onPage(alarm.action)}</p> : null}
        <p class="quiet num">
          {dayAndTime(alarm.raised_utc)} UTC{(alarm.count ?? 1) > 1 ? ` · ${T.alarms.times(alarm.count ?? 1)}` : ""}
          {alarm.acknowledged_by ? ` · ${T.alarms.by(alarm.acknowledged_by)}` : ""}
          {alarm.shelved_until_utc ? ` · ${T.alarms.shelvedUntil(dayAndTime(alarm.shelved_until_utc), alarm.shelved_by ?? "", alarm.shelved_why ?? "")}` : ""}
          {alarm.out_of_service ? ` · ${alarm.out_of_service}` : ""}
        </p>
      </div>
      <div class="cardtools">
        {fresh && !aside ? (
          <Act label={T.alarms.acknowledge} name={T.alarms.acknowledgeOf(alarm.subject)} kind="small" why={whyNot("acknowledge")} onAct={() => void acknowledge([alarm.id])} />
        ) : null}
        {alarm.shelved_until_utc ? (
          <Act label={T.alarms.unshelve} kind="small" why={whyNot("shelve")} onAct={() => void shelve(alarm, null, "")} />
        ) : (
          <Shelve alarm={alarm} />
        )}
      </div>
    </li>
  );
}

const TIMES = [600, 3600, 8 * 3600, 24 * 3600];

function Shelve({ alarm }: { alarm: Alarm }): JSX.Element {
  const [open, setOpen] = useState(false);
  const [seconds, setSeconds] = useState(3600);
  const [reason, setReason] = useState("");
  const why = whyNot("shelve");
  if (!open) return <Act label={T.alarms.shelve} name={T.alarms.shelveOf(alarm.subject)} kind="small" why={why} onAct={() => setOpen(true)} />;
  return (
    <div class="inline">
      <select aria-label={T.alarms.howLong} value={seconds} onChange={(event) => setSeconds(Number(event.currentTarget.value))}>
        {TIMES.map((time) => (
          <option key={time} value={time}>
            {T.alarms.span(time)}
          </option>
        ))}
      </select>
      <input type="text" aria-label={T.alarms.why} placeholder={T.alarms.why} maxLength={200} value={reason} onInput={(event) => setReason(event.currentTarget.value)} />
      <Act label={T.alarms.shelve} kind="small" why={why || (reason ? "" : T.alarms.whyNeeded)} onAct={() => void shelve(alarm, seconds, reason).then(() => setOpen(false))} />
    </div>
  );
}

async function acknowledge(ids: string[]): Promise<void> {
  accept(T.alarms.acknowledge, await post("acknowledge", { alarm_ids: ids }));
}

async function shelve(alarm: Alarm, seconds: number | null, why: string): Promise<void> {
  accept(T.alarms.shelve, await post("shelve", { alarm_id: alarm.id, for_s: seconds, why }));
}
