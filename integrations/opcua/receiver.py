"""The receiver of job orders: its methods, as requests to a fleet. It knows no protocol library."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime

from integrations.opcua.orders import Order, OrderRequest
from integrations.opcua.states import ABORTED, ENDED, INTERRUPTED, OrderState, find_state
from tutti import JobQueue, JobReport, Refusal, Template, Tutti, TuttiError

MAX_ORDERS = 100
LISTED_JOBS = 500
REFRESH_S = 0.3

Changed = Callable[[Order], Awaitable[None]]


class OrderReceiver:
    """The job orders of clients, each a job in the queue of the fleet: it goes on without this server, as a production
    order does. on_change: called at each change of a state; on_list: when the orders have changed in any way."""

    def __init__(self, tutti: Tutti, templates: Mapping[str, Template]) -> None:
        self.orders: dict[str, Order] = {}
        self.templates = templates
        self.queue = JobQueue(jobs=[])
        self.on_change: list[Changed] = []
        self.on_list: list[Callable[[], Awaitable[None]]] = []
        self._tutti = tutti
        self._lock = asyncio.Lock()  # requests and refreshes in turn: what one reads, the other does not change

    # Methods; each raises `TuttiError` for what it does not do

    async def store(self, request: OrderRequest, comment: str, *, held: bool) -> None:
        """Submit a job for a new order. held: it waits for `start`."""
        async with self._lock:
            if request.id in self.orders:
                text = f"there is a job order {request.id} already, {self.orders[request.id].state.name}"
                raise Refusal("bad-order", text, "give each order an ID of its own; clear one that has ended")
            self._make_room()
            order = await self._submit(request, held=held)
            order.comment = comment
            self.orders[request.id] = order
            await self._update(order)

    async def update(self, request: OrderRequest, comment: str) -> None:
        """Replace an order that has not begun; its job is a new one, behind others of its priority."""
        async with self._lock:
            old = await self._require(request.id, (1, 2), "be updated", comment)
            new = await self._submit(request, held=True)
            try:
                await self._withdraw(old)
            except TuttiError:
                await self._tutti.cancel_job(new.job_id)
                raise
            new.comment = comment
            self.orders[request.id] = new
            if old.state.number == 2:
                await self._tutti.release_jobs(new.job_id)
            await self._update(new)

    async def start(self, order_id: str, comment: str) -> None:
        """Release an order, or give the word for one that is ready to begin."""
        async with self._lock:
            order = await self._require(order_id, (1,), "be started", comment)
            await self._tutti.release_jobs(order.job_id)
            await self._update(order)

    async def revoke_start(self, order_id: str, comment: str) -> None:
        """Hold an order that has not begun."""
        async with self._lock:
            order = await self._require(order_id, (2,), "be revoked", comment)
            await self._tutti.hold_jobs(order.job_id)
            await self._update(order)

    async def pause(self, order_id: str, comment: str) -> None:
        """Pause a running order behind its present step."""
        async with self._lock:
            order = await self._require(order_id, (3,), "be paused", comment)
            await self._tutti.pause_job(order.job_id)
            await self._update(order)

    async def resume(self, order_id: str, comment: str) -> None:
        """Go on with an order that is interrupted."""
        async with self._lock:
            order = await self._require(order_id, (4,), "be resumed", comment)
            await self._tutti.resume_job(order.job_id)
            order.is_stopping = False
            await self._update(order)

    async def stop(self, order_id: str, comment: str) -> None:
        """End an order behind its present step: it is paused there, and then cancelled."""
        async with self._lock:
            order = await self._require(order_id, (3, 4), "be stopped", comment)
            if order.state.number == 3:
                await self._tutti.pause_job(order.job_id)
            order.is_stopping = True
            await self._update(order)

    async def abort(self, order_id: str, comment: str) -> None:
        """End an order now; its axes brake."""
        async with self._lock:
            order = await self._require(order_id, (1, 2, 3, 4), "be aborted", comment)
            order.is_aborting = True
            await self._tutti.cancel_job(order.job_id)
            await self._update(order)

    async def cancel(self, order_id: str, comment: str) -> None:
        """Take out an order that has not begun."""
        async with self._lock:
            await self._withdraw(await self._require(order_id, (1, 2), "be cancelled", comment))
            await self._drop(order_id)

    async def clear(self, order_id: str, comment: str) -> None:
        """Forget an order that has ended; its job stays in the journal."""
        async with self._lock:
            await self._require(order_id, (5, 6), "be cleared", comment)
            await self._drop(order_id)

    # What has become of the orders

    async def restore(self) -> None:
        """Find the orders among the jobs of the fleet, as after a start of this server."""
        queue = await self._tutti.list_jobs(LISTED_JOBS)
        for entry in reversed([entry for entry in queue if entry.actor == self._tutti.actor]):
            job_shown = await self._tutti.job(entry.id).show()
            request = None if job_shown.job is None else OrderRequest.of(job_shown.job, entry.terms)
            if request is not None:
                self.orders[request.id] = Order(request, entry.id)
        for order_id in list(self.orders)[:-MAX_ORDERS]:
            del self.orders[order_id]
        for order in list(self.orders.values()):
            await self._update(order)

    async def refresh(self) -> None:
        """Read the queue, and the orders that have changed there. Raises `Refusal`."""
        async with self._lock:
            self.queue = await self._tutti.list_jobs(LISTED_JOBS)
            entries = {entry.id: (entry.state, entry.reason, entry.held_by, entry.ready) for entry in self.queue}
            for order in list(self.orders.values()):
                entry_now = entries.get(order.job_id)
                if not order.state.is_ended and (entry_now is None or entry_now != order.known):
                    order.known = entry_now
                    await self._update(order)

    async def _update(self, order: Order) -> None:
        job_shown = await self._tutti.job(order.job_id).show()
        entry, transitions = job_shown.entry, job_shown.transitions
        if entry is None:
            return
        for transition in transitions[order.seen :]:
            if transition.state == "running" and order.began_utc is None:
                order.began_utc = transition.utc
            if transition.state != "queued":
                order.reason = transition.reason
                await self._enter(order, find_state(transition.state), job_shown.report)
        order.seen = len(transitions)
        if entry.state == "queued":
            order.reason = entry.reason
            await self._enter(order, find_state("queued", entry.reason, held=bool(entry.held_by), ready=entry.ready))
        if order.is_stopping and order.state == INTERRUPTED:
            await self._tutti.cancel_job(order.job_id)
        await self._note_list()

    async def _enter(self, order: Order, state: OrderState, report: JobReport | None = None) -> None:
        if state == ABORTED and order.is_stopping and not order.is_aborting:
            state = ENDED
        order.report = report if state.is_ended else None
        if state != order.state:
            order.state = state
            for listener in self.on_change:
                await listener(order)

    async def _submit(self, request: OrderRequest, *, held: bool) -> Order:
        job, terms = request.make_job(self.templates, datetime.now(UTC))
        submitted_job = await self._tutti.submit(job, terms=terms.model_copy(update={"held": held}))
        return Order(request, submitted_job.id)

    async def _withdraw(self, order: Order) -> None:
        """Cancel the job of an order that has not begun. It is held before, so that it does not begin meanwhile."""
        await self._tutti.hold_jobs(order.job_id)
        await self._tutti.cancel_job(order.job_id)

    async def _require(self, order_id: str, numbers: tuple[int, ...], what: str, comment: str) -> Order:
        """The order, as it is now. Raises `Refusal` if it is unknown, or in none of the states with `numbers`."""
        order = self.orders.get(order_id)
        if order is None:
            text = f"there is no job order {order_id[:200]}"
            raise Refusal("unknown-order", text, "see JobOrderList")
        if not order.state.is_ended:
            await self._update(order)
        if order.state.number not in numbers:
            raise Refusal("order-state", f"job order {order_id} is {order.state.name} and cannot {what}")
        order.comment = comment
        return order

    def _make_room(self) -> None:
        """Forget the oldest order that has ended if there are too many. Raises `Refusal` if none has."""
        if len(self.orders) < MAX_ORDERS:
            return
        ended_id = next((order_id for order_id, order in self.orders.items() if order.state.is_ended), None)
        if ended_id is None:
            text = f"{MAX_ORDERS} job orders wait or run already"
            raise Refusal("too-many-orders", text, "cancel some, or wait until one has ended")
        del self.orders[ended_id]

    async def _drop(self, order_id: str) -> None:
        del self.orders[order_id]
        await self._note_list()

    async def _note_list(self) -> None:
        for listener in self.on_list:
            await listener()
