/** What the gateway is asked again and again while a panel is shown. */

import { useEffect, useState } from "preact/hooks";
import { get } from "../core/http.ts";
import { connection } from "../core/stream.ts";

/** The answer to `path`, loaded again every `periodMs` while the page is seen and the gateway is there. */
export function usePolled<R>(path: string, periodMs: number): R | null {
  const [value, setValue] = useState<R | null>(null);
  const open = connection.value === "open";
  useEffect(() => {
    if (!open) return undefined;
    let over = false;
    let timer = 0;
    const load = async (): Promise<void> => {
      const answer = document.visibilityState === "visible" ? await get<R>(path) : null;
      if (over) return;
      if (answer && "ok" in answer) setValue(answer.ok);
      timer = setTimeout(() => void load(), periodMs);
    };
    void load();
    return () => {
      over = true;
      clearTimeout(timer);
    };
  }, [path, open]);
  return value;
}
