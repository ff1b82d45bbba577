"""Whether the parts of the fleets on a bus are of versions that work together."""

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError
from orchestrator.bus.fleets import find_fleets
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.state import ControllerInfo
from orchestrator.model.version import PartVersion, require_version
from orchestrator.runtime.doctor.findings import Finding

ANSWER_S = 2.0


async def check_parts(endpoint: str) -> list[Finding]:
    """The versions that coordinators and adapters state, each compared with those of this command. Raises
    `RouterUnreachable`."""
    bus = await open_bus(endpoint)
    try:
        return [version for fleet in await find_fleets(bus) for version in await find_versions(bus, FleetKeys(fleet))]
    finally:
        await bus.close()


async def find_versions(bus: Bus, keys: FleetKeys) -> list[Finding]:
    """The versions of the parts of one fleet."""
    stated_versions: dict[str, PartVersion] = {}
    for key, payload in (await _ask(bus, keys.leader_answer())).items():
        stated_versions[f"coordinator {key.rpartition('/')[2][:8]}"] = _read_version(LeaderHeartbeat, payload)
    for key, payload in sorted((await _ask(bus, keys.info())).items()):
        stated_versions[f"the adapter of {key.split('/')[-2]}"] = _read_version(ControllerInfo, payload)
    return [_judge(f"{name} of fleet {keys.fleet}", version) for name, version in stated_versions.items()]


async def _ask(bus: Bus, key: str) -> dict[str, bytes]:
    try:
        return dict(await bus.request_all(key, b"", ANSWER_S))
    except BusError:
        return {}


def _read_version(model: type[LeaderHeartbeat] | type[ControllerInfo], payload: bytes) -> PartVersion:
    """What a part states; of an answer that cannot be read, nothing."""
    try:
        message = model.read_message(payload)
    except ValidationError:
        return PartVersion("", "")
    return PartVersion(message.tutti, message.protocol)


def _judge(name: str, stated: PartVersion) -> Finding:
    try:
        require_version(stated, name, "this command")
    except Refusal as error:
        return Finding("versions", "failed", error.text, error.remedy)
    return Finding("versions", "ok", f"{name}: {stated}")
