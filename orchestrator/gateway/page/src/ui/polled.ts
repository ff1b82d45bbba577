/** What the gateway is asked again and again while a panel is shown. */

import { useEffect, useState } from "preact/hooks";
import { poll } from "../core/poll.ts";
import { connection } from "../core/stream.ts";

/** The answer to `path`, loaded again every `periodMs` while the page is seen and the gateway is there. */
export function usePolled<R>(path: string, periodMs: number): R | null {
  const [value, setValue] = useState<R | null>(null);
  const open = connection.value === "open";
  useEffect(() => {
    if (!open) return undefined;
    return poll<R>(path, periodMs, (answer) => setValue(answer));
  }, [path, open]);
  return value;
}
