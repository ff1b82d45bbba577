import { render } from "preact";
import { watchAlarms } from "./core/alarms.ts";
import { watchAttention } from "./core/attention.ts";
import { watchEvents } from "./core/eventlog.ts";
import { watchPads } from "./core/gamepad.ts";
import { watchKeys } from "./core/keys.ts";
import { watchReports } from "./core/lastreport.ts";
import { watchMany } from "./core/many.ts";
import { watchAddress } from "./core/look.ts";
import { watchPage } from "./core/manual.ts";
import { watchZones } from "./core/zones.ts";
import * as stream from "./core/stream.ts";
import { App } from "./ui/app.tsx";
import { watchDrops } from "./ui/submit.tsx";
import "./style.css";

declare global {
  interface Window {
    /** For benches and tests: the way of a frame from the socket, and how many have been taken. */
    tutti?: { feed(frame: string): void; readonly updates: number };
  }
}

window.tutti = {
  feed: stream.handleFrame,
  get updates() {
    return stream.updates;
  },
};

const place = document.getElementById("page");
if (place !== null) {
  watchAddress();
  watchKeys();
  watchPage();
  watchPads();
  watchAlarms();
  watchAttention();
  watchEvents();
  watchReports();
  watchDrops();
  watchZones();
  watchMany();
  stream.start();
  render(<App />, place);
}
