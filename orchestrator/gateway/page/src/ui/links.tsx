/** Links: age, bytes, errors of each, and the trace of the last minute. */

import type { JSX } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { explain, formatBytes } from "../core/format.ts";
import { get } from "../core/http.ts";
import type { Refusal } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { controllers } from "../core/store.ts";
import { pageAge } from "../core/stream.ts";
import * as T from "../texts.ts";
import { Act, Empty, Mark, Panel } from "./parts.tsx";

interface TraceFrame {
  /** Seconds, negative: before the answer. Kept as an instant on this page's own clock. */
  at_s: number;
  direction: string;
  text: string;
  meaning?: string;
}

const MOST_FRAMES = 500;
const REFRESH_MS = 1000;
const RETRY_MS = 5000;

export function LinksPanel(): JSX.Element {
  const [traced, setTraced] = useState("");
  return (
    <Panel title={T.links.title} area="links">
      <table class="num">
        <thead>
          <tr>
            <th scope="col">{T.controller}</th>
            <th scope="col">{T.links.state}</th>
            <th scope="col">{T.links.age}</th>
            <th scope="col">{T.links.out}</th>
            <th scope="col">{T.links.in}</th>
            <th scope="col">{T.links.errors}</th>
            <th scope="col">
              <span class="hidden">{T.links.trace}</span>
            </th>
          </tr>
        </thead>
        <tbody>
          {controllers.value.map((controller) => {
            const { present, mode } = controller.rest.value;
            const link = controller.link.value;
            const age = Math.max(controller.age.value, pageAge.value);
            const bad = !present || mode === "offline" || age >= 1;
            return (
              <tr key={controller.id} class={age >= 1 ? "stale" : ""}>
                <th scope="row">{controller.id}</th>
                <td>
                  <Mark level={bad ? "bad" : "ok"} text={T.mode(present ? mode : "absent")} />
                </td>
                <td>{age >= 1 ? `${age} s` : "< 1 s"}</td>
                <td>{formatBytes(link?.bytes_out)}</td>
                <td>{formatBytes(link?.bytes_in)}</td>
                <td>{link?.errors ?? "–"}</td>
                <td>
                  <Act
                    label={T.links.trace}
                    name={T.links.traceOf(controller.id)}
                    kind="small"
                    pressed={traced === controller.id}
                    onAct={() => setTraced(traced === controller.id ? "" : controller.id)}
                  />
                </td>
              </tr>
            );
          })}
        </tbody>
      </table>
      {traced ? <Trace key={traced} controller={traced} /> : null}
    </Panel>
  );
}

/** `beside`: it stands beside something else, so that it says in its place why there is none, and goes on trying. */
export function Trace({ controller, beside = false }: { controller: string; beside?: boolean }): JSX.Element {
  const [frames, setFrames] = useState<TraceFrame[] | null>(null);
  const [refused, setRefused] = useState<Refusal | null>(null);
  const newest = useRef(0);
  useEffect(() => {
    let over = false;
    let timer = 0;
    const load = async (): Promise<void> => {
      const answer = await get<{ frames: TraceFrame[]; newest: number }>(`trace/${encodeURIComponent(controller)}?after=${newest.current}`);
      if (over) return;
      setRefused(beside && "refused" in answer ? answer.refused : null);
      if (beside && "refused" in answer) {
        timer = setTimeout(() => void load(), RETRY_MS);
        return;
      }
      const part = accept(T.links.traceOf(controller), answer);
      if (part === null) return setFrames((before) => before ?? []);
      newest.current = part.newest;
      const now = performance.now() / 1000;
      const fresh = part.frames.map((frame) => ({ ...frame, at_s: now + frame.at_s }));
      setFrames((before) => [...(before ?? []), ...fresh].slice(-MOST_FRAMES));
      timer = setTimeout(() => void load(), REFRESH_MS);
    };
    void load();
    return () => {
      over = true;
      clearTimeout(timer);
    };
  }, [controller]);
  const now = performance.now() / 1000;
  if (refused !== null) return <p class="reason">{explain(refused)}</p>;
  if (frames === null) return <Empty text={T.loading} />;
  if (frames.length === 0) return <Empty text={T.links.noTrace} />;
  return (
    <div class="scroll trace" role="log" aria-label={T.links.traceOf(controller)} tabIndex={0}>
      <table>
        <tbody>
          {[...frames].reverse().map((frame, index) => (
            <tr key={`${frame.at_s} ${index}`}>
              <td class="num when">{`${(frame.at_s - now).toFixed(4)} s`}</td>
              <td>{frame.direction === "out" ? "→" : "←"}</td>
              <td>
                <code>{frame.text}</code>
              </td>
              <td class="quiet">{frame.meaning}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
