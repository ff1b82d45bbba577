/** Signing in. The gateway limits how often it can be tried. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { explain } from "../core/format.ts";
import { get, post } from "../core/http.ts";
import type { Refusal, Session } from "../core/model.ts";
import { reconnect, session } from "../core/stream.ts";
import * as T from "../texts.ts";

export function Login(): JSX.Element {
  const [user, setUser] = useState("");
  const [password, setPassword] = useState("");
  const [refused, setRefused] = useState<Refusal | null>(null);
  const [busy, setBusy] = useState(false);
  const signIn = async (): Promise<void> => {
    setBusy(true);
    const answer = await post<Session>("login", { user, password });
    setBusy(false);
    setPassword("");
    if ("refused" in answer) return setRefused(answer.refused);
    session.value = answer.ok;
    reconnect();
  };
  const [canStop, setCanStop] = useState(false);
  const [stopped, setStopped] = useState("");
  useEffect(() => {
    void get<{ stop: boolean }>("sign-in").then((answer) => setCanStop("ok" in answer && answer.ok.stop));
  }, []);
  const stop = async (): Promise<void> => {
    const answer = await post<{ answers: Record<string, Refusal | null> }>("stop");
    if ("refused" in answer) return setStopped(explain(answer.refused));
    const failed = Object.entries(answer.ok.answers).filter(([, refusal]) => refusal !== null);
    setStopped(failed.length ? T.login.notStopped(failed.map(([name]) => name)) : T.login.stopped);
  };
  return (
    <main class="login">
      <form
        class="panel"
        aria-label={T.login.title}
        onSubmit={(event) => {
          event.preventDefault();
          void signIn();
        }}
      >
        <h1>{T.login.title}</h1>
        <label class="field">
          <span>{T.login.user}</span>
          <input type="text" name="user" autocomplete="username" required value={user} onInput={(event) => setUser(event.currentTarget.value)} />
        </label>
        <label class="field">
          <span>{T.login.password}</span>
          <input type="password" name="password" autocomplete="current-password" required value={password} onInput={(event) => setPassword(event.currentTarget.value)} />
        </label>
        {refused ? (
          <p class="reason bad" role="alert">
            <span aria-hidden="true">▲</span> {explain(refused)}
          </p>
        ) : null}
        <button type="submit" class="act strong" disabled={busy}>
          {T.login.signIn}
        </button>
        {canStop ? (
          <button type="button" class="stop" onClick={() => void stop()}>
            {T.login.stop}
          </button>
        ) : (
          <p class="hint">{T.login.stopHint}</p>
        )}
        {stopped ? <p role="alert">{stopped}</p> : null}
      </form>
    </main>
  );
}

export async function signOut(): Promise<void> {
  await post("logout");
  session.value = null;
  reconnect();
}
