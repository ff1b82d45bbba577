/** What the gateway is asked again and again. */

import { get } from "./http.ts";

/** Load `path` every `periodMs` while the page is seen, until the result is called, or `take` returns true. */
export function poll<R>(path: string, periodMs: number, take: (answer: R) => boolean | void): () => void {
  let over = false;
  let timer = 0;
  const load = async (): Promise<void> => {
    const answer = document.visibilityState === "visible" ? await get<R>(path) : null;
    if (over || (answer && "ok" in answer && take(answer.ok))) return;
    timer = setTimeout(() => void load(), periodMs);
  };
  void load();
  return () => {
    over = true;
    clearTimeout(timer);
  };
}
