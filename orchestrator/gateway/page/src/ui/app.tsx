/** The page: head, stop bar, messages, and one of the three views. */

import type { JSX } from "preact";
import { stacked, view } from "../core/look.ts";
import { connection } from "../core/stream.ts";
import * as T from "../texts.ts";
import { AlarmsPanel } from "./alarmlist.tsx";
import { AxisTable } from "./axes.tsx";
import { ButtonsPanel } from "./buttons.tsx";
import { CamerasPanel } from "./cameras.tsx";
import { ClocksPanel } from "./clocks.tsx";
import { CommandsPanel, ConfigurationPanel, RecordingsPanel } from "./configuration.tsx";
import { EventsPanel } from "./eventlist.tsx";
import { Header } from "./header.tsx";
import { HistoryPanel } from "./history.tsx";
import { IoPanel } from "./io.tsx";
import { JobPanel, runningJobs } from "./job.tsx";
import { across, JogPanel } from "./jogpad.tsx";
import { LinksPanel } from "./links.tsx";
import { LivePlots } from "./liveplots.tsx";
import { Login } from "./login.tsx";
import { ManyBar } from "./many.tsx";
import { Messages } from "./messages.tsx";
import { PlanePanel } from "./plane.tsx";
import { ConsolePanel } from "./console.tsx";
import { DialogHost } from "./parts.tsx";
import { PositionsPanel } from "./positions.tsx";
import { PreparePanel } from "./prepare.tsx";
import { QueuePanel } from "./queue.tsx";
import { StopBar } from "./stopbar.tsx";
import { dropping } from "./submit.tsx";
import { ZonesPanel } from "./zones.tsx";

export function App(): JSX.Element {
  if (connection.value === "signed-out") return <Login />;
  return (
    <div class="page">
      <Header />
      <StopBar />
      <Messages />
      <main>
        <ManyBar />
        <div class={`view ${view.value}`} data-testid={`view-${view.value}`}>
          <ViewPanels />
        </div>
      </main>
      <DialogHost />
      {dropping.value ? <div class="drophint">{T.submit.dropHere}</div> : null}
    </div>
  );
}

function ViewPanels(): JSX.Element {
  if (view.value === "run" && stacked.value)
    return (
      <div class="column">
        {runningJobs.value.length > 0 ? <JobPanel key="job" /> : null}
        <AxisTable key="axes" />
        <CamerasPanel key="cameras" />
        <ButtonsPanel key="buttons" />
        {runningJobs.value.length > 0 ? null : <JobPanel key="job" />}
        <QueuePanel key="queue" />
        <LivePlots key="plots" />
        <PlanePanel key="plane" />
        <ZonesPanel key="zones" />
      </div>
    );
  if (view.value === "run")
    return (
      <>
        <div class="column">
          <AxisTable />
          <CamerasPanel />
          <div class="pictures">
            <LivePlots />
            <PlanePanel />
            <ZonesPanel />
          </div>
        </div>
        <div class="column right">
          <ButtonsPanel />
          <JobPanel />
          <QueuePanel />
        </div>
      </>
    );
  if (view.value === "setup")
    return (
      <>
        <div class="column">
          <JogPanel />
          <PreparePanel />
        </div>
        <div class="column">
          <AxisTable onChoose={(axis) => (across.value = axis)} chosen={across.value} />
          <PlanePanel />
          <ZonesPanel />
          <CamerasPanel />
          <ButtonsPanel />
          <PositionsPanel />
          <IoPanel />
        </div>
      </>
    );
  return (
    <>
      <AlarmsPanel />
      <ClocksPanel />
      <LinksPanel />
      <EventsPanel />
      <HistoryPanel />
      <ConfigurationPanel />
      <RecordingsPanel />
      <CommandsPanel />
      <ConsolePanel />
    </>
  );
}

