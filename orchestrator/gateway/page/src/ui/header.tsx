/** The head of the page: what the fleet does, its alarms one step away, the views. */

import type { JSX } from "preact";
import { newAlarms, openAlarms, openBus } from "../core/alarms.ts";
import { timeOfDay } from "../core/format.ts";
import { STOP_KEYS, stopKey } from "../core/keys.ts";
import { showView, soundOn, theme, view, VIEWS, type Theme } from "../core/look.ts";
import { isMany, namesIn } from "../core/many.ts";
import { isBusy } from "../core/manual.ts";
import type { Level } from "../core/ready.ts";
import { controllers, coordinator, fleetName, jobs, loaded, permits, queue, utc } from "../core/store.ts";
import { connection, pageAge, session } from "../core/stream.ts";
import * as T from "../texts.ts";
import { AlarmList } from "./alarmlist.tsx";
import { signOut } from "./login.tsx";
import { Act, Field, Mark, openDialog } from "./parts.tsx";

/** The state of the fleet in words: the worst thing that holds. */
function fleetState(): { level: Level; text: string } {
  const all = controllers.value.map((controller) => controller.rest.value);
  const named = (test: (index: number) => boolean): string =>
    controllers.value
      .filter((_, index) => test(index))
      .map((controller) => controller.id)
      .join(", ");
  const many = isMany.value;
  const worst: [string, (text: string) => string][] = [
    [many ? namesIn("e-stop") : named((i) => Boolean(all[i]?.estop)), T.fleet.estop],
    [many ? namesIn("silent") : named((i) => all[i]?.present === false), T.fleet.absent],
    [many ? namesIn("offline") : named((i) => all[i]?.mode === "offline"), T.fleet.offline],
    [many ? namesIn("fault") : named((i) => all[i]?.mode === "fault"), T.fleet.fault],
  ];
  for (const [names, words] of worst) if (names) return { level: "bad", text: words(names) };
  if (permits.value.length > 0) return { level: "bad", text: T.fleet.permit(permits.value.map((permit) => permit.name).join(", ")) };
  const running = Object.values(jobs.value).find((job) => ["planning", "arming", "armed", "committed", "running"].includes(job.state));
  if (running) return { level: "busy", text: T.fleet.running(running.name) };
  const moving = named((i) => ["moving", "jogging", "homing", "stopping"].includes(all[i]?.mode ?? ""));
  if (moving) return { level: "busy", text: T.fleet.moving(moving) };
  if (queue.value.stopped && (queue.value.waiting ?? 0) > 0) return { level: "off", text: T.fleet.queueStopped };
  return { level: "ok", text: T.fleet.idle };
}

export function Header(): JSX.Element {
  const state = loaded.value ? fleetState() : { level: "off" as Level, text: T.loading };
  const stale = pageAge.value > 0;
  return (
    <header class="top">
      <div class="topline">
        <h1>{fleetName.value || "Tutti"}</h1>
        <div class={`fleetstate ${stale ? "stale" : ""}`} role="status" aria-label={T.fleet.state}>
          <Mark level={state.level} text={state.text} />
        </div>
        <AlarmButton />
      </div>
      <div class="topline">
        <nav aria-label={T.view.nav}>
          {VIEWS.map((each) => (
            <button
              key={each}
              type="button"
              class="tab"
              aria-current={view.value === each ? "page" : undefined}
              aria-disabled={isBusy.value && view.value !== each ? "true" : undefined}
              title={isBusy.value && view.value !== each ? T.view.lockedRemedy : undefined}
              onClick={() => showView(each)}
            >
              {T.view.names[each]}
            </button>
          ))}
        </nav>
        <Link />
        <span class="userline">
          <b>{session.value?.user ?? T.user.none}</b> <span class="quiet">{session.value ? T.role[session.value.role] : ""}</span>
        </span>
        <Act label="☰" name={T.settings.title} kind="small" onAct={() => openDialog(T.settings.title, <Settings />)} />
      </div>
      <OpenBus />
    </header>
  );
}

/** Other computers reach the bus: not among the messages, because it stands for days, and would take a place from them. */
function OpenBus(): JSX.Element | null {
  if (!openBus.value) return null;
  return (
    <p class="message bad" role="alert">
      <span class="text">
        <span aria-hidden="true">▲</span> {openBus.value}
      </span>
    </p>
  );
}

function Link(): JSX.Element {
  const age = pageAge.value;
  const bad = connection.value !== "open" || age > 0;
  const text = connection.value === "open" ? (age > 0 ? T.link.old(age) : T.link.fresh(timeOfDay(utc.value))) : T.link.lost(age);
  return (
    <span class={`linkline num ${bad ? "bad" : ""}`}>
      <span aria-hidden="true">{bad ? "▲" : "●"}</span> {text}
      {bad ? "" : <span class="wideonly"> UTC</span>}
      {coordinator.value.present || bad ? "" : ` · ${T.link.noCoordinator}`}
    </span>
  );
}

function AlarmButton(): JSX.Element {
  const fresh = newAlarms.value.length;
  const open = openAlarms.value.length;
  return (
    <button type="button" class={`alarmbutton ${fresh > 0 ? "fresh" : open > 0 ? "open" : ""}`} onClick={() => openDialog(T.alarms.title, <AlarmList />, true)}>
      <span aria-hidden="true">{fresh > 0 ? "▲" : "△"}</span> {T.alarms.count(open)}
      {fresh > 0 ? <span class="wideonly">{T.alarms.fresh(fresh)}</span> : null}
    </button>
  );
}

function KeyTable(): JSX.Element {
  return (
    <section aria-label={T.keys.title}>
      <h3>{T.keys.title}</h3>
      <table class="keys">
        <thead>
          <tr>
            <th scope="col">{T.keys.key}</th>
            <th scope="col">{T.keys.where}</th>
            <th scope="col">{T.keys.what}</th>
          </tr>
        </thead>
        <tbody>
          {T.keys.table(T.keys.names(stopKey.value)).map(([key, where, what]) => (
            <tr key={`${key} ${where}`}>
              <th scope="row">{key}</th>
              <td>{where}</td>
              <td>{what}</td>
            </tr>
          ))}
        </tbody>
      </table>
      <Field label={T.keys.choose}>
        <select value={stopKey.value} onChange={(event) => (stopKey.value = event.currentTarget.value)}>
          {STOP_KEYS.map((key) => (
            <option key={key} value={key}>
              {key ? T.keys.names(key) : T.keys.none}
            </option>
          ))}
        </select>
      </Field>
    </section>
  );
}

const THEMES: Theme[] = ["auto", "light", "dark"];

function Settings(): JSX.Element {
  return (
    <div class="menu">
      <fieldset class="choice">
        <legend>{T.settings.theme}</legend>
        {THEMES.map((each) => (
          <Act key={each} label={T.settings.themes[each]} kind="small" pressed={theme.value === each} onAct={() => (theme.value = each)} />
        ))}
      </fieldset>
      <label class="check">
        <input type="checkbox" checked={soundOn.value} onChange={(event) => (soundOn.value = event.currentTarget.checked)} />
        {T.settings.sound}
      </label>
      <p>
        {session.value?.user ?? T.user.none}, {session.value ? T.role[session.value.role] : ""}
      </p>
      <p class="quiet">{T.settings.version(session.value?.version ?? "–")}</p>
      <KeyTable />
      {session.value?.user ? <Act label={T.user.signOut} onAct={() => void signOut()} /> : null}
    </div>
  );
}
