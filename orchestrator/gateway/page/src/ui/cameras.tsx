/**
 * Cameras of the machine, one at a time: those of the fleet file, and nothing else, by the policy that came with the page.
 *
 * Nothing is loaded while they are hidden. A page of a camera is in a frame that can neither leave its place nor reach this one.
 * It cannot get the focus either: keys in it, among them the stop keys, would not arrive here.
 */

import type { JSX } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { WebView } from "../core/model.ts";
import { isFlag, isText, remembered } from "../core/remember.ts";
import { views } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, Panel } from "./parts.tsx";

const PATIENCE_MS = 10_000;
const LOOK_MS = 500;
const RETRY_MS = 5_000;

const shown = remembered("cameras.shown", true, isFlag);
const chosen = remembered("cameras.chosen", "", isText);

/** Nothing at all while the fleet file has no cameras. */
export function CamerasPanel(): JSX.Element | null {
  const all = views.value;
  const view = all.find((each) => each.title === chosen.value) ?? all[0];
  if (view === undefined) return null;
  const choices = all.length > 1 && shown.value ? all : [];
  return (
    <Panel title={T.cameras.title} area={`cameras ${shown.value ? "" : "folded"}`} tools={<Act label={shown.value ? T.cameras.hide : T.cameras.show} kind="small" onAct={() => (shown.value = !shown.value)} />}>
      {choices.length > 0 ? (
        <div class="row">
          {choices.map((each) => (
            <Act key={each.title} label={each.title} kind="small" pressed={each === view} onAct={() => (chosen.value = each.title)} />
          ))}
        </div>
      ) : null}
      {shown.value ? <Camera key={`${view.kind} ${view.url}`} view={view} /> : null}
      {shown.value ? <p class="hint">{T.cameras.note}</p> : null}
    </Panel>
  );
}

type Trouble = "silent" | "late" | "unknown" | "plain" | null;

function Camera({ view }: { view: WebView }): JSX.Element {
  const isPlain = location.protocol === "https:" && view.url.startsWith("http:");
  const [trouble, setTrouble] = useState<Trouble>(isPlain ? "plain" : null);
  const [there, setThere] = useState(false);
  const [round, setRound] = useState(0);
  const picture = useRef<HTMLImageElement>(null);
  const begin = (): void => {
    setThere(false);
    setTrouble(null);
    setRound((now) => now + 1);
  };
  // A frame is refused as soon as it is in the document: later it would be too late to listen.
  useLayoutEffect(() => {
    const origin = new URL(view.url).origin;
    const note = (event: SecurityPolicyViolationEvent): void => {
      if (event.blockedURI === view.url || event.blockedURI === origin || event.blockedURI.startsWith(`${origin}/`)) setTrouble("unknown");
    };
    document.addEventListener("securitypolicyviolation", note);
    return () => document.removeEventListener("securitypolicyviolation", note);
  }, [view.url]);
  useEffect(() => {
    if (there || trouble === "plain" || trouble === "unknown") return undefined;
    if (trouble === "silent") {
      const timer = setTimeout(begin, RETRY_MS);
      return () => clearTimeout(timer);
    }
    // A stream of pictures may never be loaded; that it has a size means that a picture has come.
    const look = setInterval(() => (picture.current?.naturalWidth ? setThere(true) : undefined), LOOK_MS);
    const late = setTimeout(() => setTrouble("late"), PATIENCE_MS);
    return () => {
      clearInterval(look);
      clearTimeout(late);
    };
  }, [there, trouble, round]);
  // A policy says no before a picture fails: that reason is the better one.
  const fail = (): void => setTrouble((now) => (now === "unknown" ? now : "silent"));
  const arrive = (): void => {
    setThere(true);
    setTrouble((now) => (now === "unknown" ? now : null));
  };
  const isLoaded = trouble !== "plain" && trouble !== "unknown" && trouble !== "silent";
  return (
    <div class="camera">
      {!isLoaded ? null : view.kind === "image" ? (
        <img key={round} ref={picture} src={view.url} alt={view.title} referrerpolicy="no-referrer" onLoad={arrive} onError={fail} />
      ) : (
        <iframe key={round} src={view.url} title={view.title} inert sandbox="allow-scripts allow-same-origin" referrerpolicy="no-referrer" onLoad={arrive} />
      )}
      {there && trouble === null ? null : <Cover view={view} trouble={trouble} onAgain={begin} />}
    </div>
  );
}

function Cover({ view, trouble, onAgain }: { view: WebView; trouble: Trouble; onAgain: () => void }): JSX.Element {
  const { title } = view;
  if (trouble === null) return <p class="cover quiet">{T.cameras.loading(title)}</p>;
  const [text, remedy] = {
    silent: [T.cameras.silent(title), T.cameras.silentRemedy(new URL(view.url).host)],
    late: [T.cameras.silent(title), `${T.cameras.late} ${T.cameras.silentRemedy(new URL(view.url).host)}`],
    unknown: [T.cameras.unknown(title), T.cameras.unknownRemedy],
    plain: [T.cameras.plain(title), T.cameras.plainRemedy],
  }[trouble];
  return (
    <div class="cover" role="alert">
      <p class="reason bad">{`▲ ${text}`}</p>
      <p class="reason">{remedy}</p>
      {trouble === "plain" || trouble === "unknown" ? null : <Act label={T.cameras.again} kind="small" onAct={onAgain} />}
    </div>
  );
}
