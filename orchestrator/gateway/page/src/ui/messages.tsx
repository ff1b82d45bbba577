/**
 * What must not be overlooked, and stays until it is over or dismissed.
 *
 * The two most important messages have a place of fixed height, so that nothing below moves under a finger when one
 * comes; all are in a dialog one press away.
 */

import type { JSX } from "preact";
import { explain, timeOfDay } from "../core/format.ts";
import { isMany, namesIn } from "../core/many.ts";
import { isText, remembered } from "../core/remember.ts";
import { dismiss, notices, type Notice } from "../core/notices.ts";
import { whyNot } from "../core/rights.ts";
import { resetFleet, stoppedBy } from "../core/stop.ts";
import { controllers, coordinator, lastStop, loaded, queue } from "../core/store.ts";
import { connection, pageAge, session } from "../core/stream.ts";
import * as T from "../texts.ts";
import { Act, openDialog } from "./parts.tsx";
import { askStart, readyJobs } from "./start.tsx";

interface Message {
  key: string;
  level: "bad" | "warn" | "quiet";
  sign: string;
  title?: string;
  text: string;
  remedy?: string;
  code?: string;
  act?: { label: string; why: string; motion?: boolean; onAct: () => void };
}

const SLOTS = 2;

export function Messages(): JSX.Element {
  const all = listMessages();
  const shown = all.slice(0, SLOTS);
  const more = all.length - shown.length;
  return (
    <section class="messages" aria-label={T.messages.title} aria-live="polite">
      {shown.map((message) => (
        <Line key={message.key} message={message} brief />
      ))}
      {shown.length === 0 ? <p class="message quiet">{T.messages.none}</p> : null}
      {more > 0 ? <Act label={T.messages.more(more)} kind="small" onAct={() => openDialog(T.messages.title, <AllMessages />, true)} /> : null}
    </section>
  );
}

function AllMessages(): JSX.Element {
  return (
    <ul class="cards">
      {listMessages().map((message) => (
        <li key={message.key}>
          <Line message={message} />
        </li>
      ))}
    </ul>
  );
}

function Line({ message, brief = false }: { message: Message; brief?: boolean }): JSX.Element {
  const whole = [message.title, explain(message)].filter(Boolean).join(": ");
  return (
    <div class={`message ${message.level} ${brief ? "brief" : ""}`} role={message.level === "bad" ? "alert" : undefined} title={brief ? whole : undefined}>
      <span class="text">
        <span aria-hidden="true">{message.sign}</span> {message.title ? <b>{message.text ? `${message.title}: ` : message.title}</b> : null}
        {explain(message)} {message.code ? <code>{message.code}</code> : null}
      </span>
      {message.act ? <Act label={message.act.label} kind="small" why={message.act.why} motion={message.act.motion ?? false} onAct={message.act.onAct} /> : null}
    </div>
  );
}

/** What is urgent, then conditions, the worst before; then what has been answered, the newest before. */
function listMessages(): Message[] {
  const all: Message[] = [];
  const add = (key: string, level: Message["level"], sign: string, text: string): number => all.push({ key, level, sign, text });
  all.push(...notices.value.filter((notice) => notice.urgent).map(messageOf));
  if (connection.value !== "open") add("lost", "bad", "▲", T.messages.lost(pageAge.value));
  else if (loaded.value && !coordinator.value.present) add("coordinator", "bad", "▲", T.messages.noCoordinator);
  const estopped = controllers.value.filter((controller) => controller.rest.value.estop);
  const estop = estopped[0]?.rest.value.estop;
  if (estop) {
    const names = (isMany.value && namesIn("e-stop")) || estopped.map((each) => each.id).join(", ");
    all.push({
      key: "estop",
      level: "bad",
      sign: "■",
      text: T.messages.estop(names, estop.actor, estop.reason, timeOfDay(estop.utc)),
      act: { label: T.stop.reset, why: whyNot("reset"), onAct: () => void resetFleet() },
    });
  }
  const faulty = controllers.value.filter((controller) => controller.rest.value.mode === "fault" && !controller.rest.value.estop);
  if (faulty.length > 0)
    all.push({
      key: "fault",
      level: "warn",
      sign: "▲",
      text: T.messages.fault((isMany.value && namesIn("fault")) || faulty.map((each) => each.id).join(", ")),
      act: { label: T.stop.reset, why: whyNot("reset"), onAct: () => void resetFleet() },
    });
  const stopped = stoppedBy.value ?? undismissed();
  if (stopped && !(estop && stopped.what === "estop"))
    all.push({
      key: "stopped",
      level: "warn",
      sign: "■",
      text: T.messages.stopped(stopped.what, stopped.by, timeOfDay(stopped.utc)),
      act: {
        label: T.dismiss,
        why: "",
        onAct: () => {
          dismissedStop.value = lastStop.value?.utc ?? stopped.utc ?? "";
          stoppedBy.value = null;
        },
      },
    });
  const waiting = queue.value.waiting ?? 0;
  const start = { label: queue.value.stopped ? T.queue.start : T.start.begin, why: whyNot("start-queue"), motion: true, onAct: () => void askStart() };
  if (readyJobs.value.length > 0)
    all.push({ key: "ready", level: "warn", sign: "▶", text: T.start.readyJobs(readyJobs.value.map((job) => job.name)), act: start });
  else if (queue.value.stopped && waiting > 0 && !estop)
    all.push({ key: "queue", level: "warn", sign: "■", text: T.start.queueStopped(waiting), act: start });
  all.push(...notices.value.filter((notice) => !notice.urgent).map(messageOf));
  if (session.value && !session.value.users) add("users", "quiet", "ℹ", T.messages.noUsers);
  return all;
}

const dismissedStop = remembered("stop.dismissed", "", isText);

/** A stop from before this page was opened is shown too, once. */
function undismissed(): typeof lastStop.value {
  const last = lastStop.value;
  return last && (last.utc ?? "") !== dismissedStop.value ? last : undefined;
}

function messageOf(notice: Notice): Message {
  return {
    key: `notice ${notice.key}`,
    level: notice.urgent ? "bad" : notice.kind === "refusal" ? "warn" : "quiet",
    sign: notice.kind === "refusal" ? "▲" : "ℹ",
    title: notice.count > 1 ? `${notice.title} (${notice.count}×)` : notice.title,
    text: notice.controller ? `${notice.controller}: ${notice.text}` : notice.text,
    remedy: notice.remedy,
    code: notice.code,
    act: { label: T.dismiss, why: "", onAct: () => dismiss(notice.key) },
  };
}
