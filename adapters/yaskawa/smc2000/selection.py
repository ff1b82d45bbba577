"""The selection of a controller on its line: the session's settings, its address, and a marker that proves both."""

import re

from adapters.contract import DriverLog
from adapters.yaskawa.smc2000.exchange import SerialExchange
from adapters.yaskawa.smc2000.line import SharedSerialLine, address_command
from adapters.yaskawa.wire.exchange import garbage_fault
from orchestrator.link.base import Link
from orchestrator.model.errors import ControllerFault

ADDRESS = "XUN"
"""The variable in which a controller of a chain keeps its address."""

# Numbers without leading zeros (LZ, L10237), whole (VF, PF; L4877-4957), program output marked (CW), no echo.
_SETTINGS = ("EO 0", "CW 1", "LZ 1", "PF 10.0", "VF 10.0")
_TRIES = 2
_MOST_BEFORE_MARKER = 500
"""Characters before a marker: more than any reply but a whole listing, whose rest the next attempt discards."""


class ControllerSelection:
    """The selection of one controller. unit: its address in a chain, None for a controller alone on its line."""

    def __init__(self, line: SharedSerialLine, link: Link, unit: int | None, exchange: SerialExchange) -> None:
        self._line = line
        self._link = link
        self._unit = unit
        self._exchange = exchange
        self.address_known = False
        """Whether the controller can prove its address."""

    async def select_controller(self, log: DriverLog) -> None:
        """Ensure that the controller receives the next command, and that nothing else precedes its reply."""
        line = self._line
        if line.ahead is not None:
            line.mark_out_of_step()
        # A controller that is already missing does not take the others' time twice.
        tries_left = 1 if self._unit in line.missing else _TRIES
        while not (line.in_step and line.selected == self._unit and self._exchange.settled):
            stops, line.in_step, line.selected = line.stops, False, None
            marker = line.next_marker()
            query = f'MG "{marker}",{ADDRESS}' if self.address_known else f'MG "{marker}"'
            # A half-typed line is spoiled before it is ended; an operator's entry and a download end (L4812, L8205).
            opening = "" if self._exchange.settled and not line.half_line else "\\\r"
            settings = () if self._exchange.settled else _SETTINGS
            opening += self._address_prefix(tries_left) + "".join(f"{command}\r" for command in settings)
            try:
                reply = await self._marked_reply(opening, query, marker)
                if self.address_known and reply != str(self._unit) and line.stops == stops:
                    raise garbage_fault(
                        self._link, f"%{self._unit}", f"the controller with address {self._unit}", repr(reply)
                    )
            except ControllerFault as error:
                if line.stops == stops:
                    self._exchange.settled = False
                    tries_left -= 1
                    log.warning(f"the controller is not selected: {error.text}", tries_left=tries_left)
                    if not tries_left:
                        if self._unit is not None:
                            line.missing.add(self._unit)
                        raise
                continue
            if line.stops == stops:
                if not self._exchange.settled:
                    log.info("the session is synchronised", address=self._unit)
                line.in_step, line.selected, self._exchange.settled, line.half_line = True, self._unit, True, False
                line.missing.discard(self._unit)

    def _address_prefix(self, left: int) -> str:
        """Return the command that selects this address. A controller alone needs none, unless another address was
        selected before."""
        if self._unit is None:
            return "" if left > 1 or self._exchange.settled else address_command(0)
        return address_command(self._unit)

    async def _marked_reply(self, opening: str, query: str, marker: str) -> str:
        """Discard everything up to the answer to `query`; return what follows the marker in it."""
        pattern = re.compile(re.escape(marker.encode()) + rb"([ \-0-9.]*)\r\n:")

        def find_whole_reply() -> str | None:
            self._exchange.separate_output()
            reply_match = pattern.search(self._exchange.plain)
            return None if reply_match is None else reply_match[1].decode().strip()

        reply, _ = await self._exchange.run(query, find_whole_reply, opening, most=_MOST_BEFORE_MARKER)
        return reply
