"""Comparison of all settings on request, before a job begins: what is found then makes the job wait, not fail."""

from collections.abc import Callable

from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.monitoring.surveillance import Surveillance
from adapters.controller.publishing.publisher import StatePublisher
from orchestrator.model.errors import SETTING_CHANGED, Refusal
from orchestrator.model.messages import CheckSettingsRequest, LeasedRequest, SettingsChecked


class SettingsChecks:
    """The checks of one controller. require_idle: raises `Refusal` unless the requester may use its axes, and no step
    is loaded."""

    def __init__(
        self,
        surveillance: Surveillance,
        polling: StatePolling,
        publisher: StatePublisher,
        require_idle: Callable[[LeasedRequest], None],
    ) -> None:
        self._surveillance = surveillance
        self._polling = polling
        self._publisher = publisher
        self._require_idle = require_idle

    async def check_settings(self, request: CheckSettingsRequest) -> SettingsChecked:
        """Compare all settings; answer with the state, whose faults name what differs. Raises `Refusal`,
        `ControllerFault`, `LinkClosed`."""
        self._require_idle(request)
        try:
            await self._surveillance.require_settings()
        except Refusal as refusal:
            if refusal.code != SETTING_CHANGED:
                raise
            await self._polling.poll_and_publish()
            return SettingsChecked(state=self._publisher.answer_state())
        return SettingsChecked()
