/** Signing in. The gateway limits how often it can be tried. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { explain } from "../core/format.ts";
import { post } from "../core/http.ts";
import type { Refusal, Session } from "../core/model.ts";
import { reconnect, session } from "../core/stream.ts";
import { T } from "../texts.ts";

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
        <p class="hint">{T.login.stopHint}</p>
      </form>
    </main>
  );
}

export async function signOut(): Promise<void> {
  await post("logout");
  session.value = null;
  reconnect();
}
