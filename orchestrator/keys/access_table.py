"""The access table: what each role may do with which keys. What is not in it is denied.

The router lets a message pass if a key expression of the table includes that of the message. So a request on a wildcard
needs a row that is as wide, and a row for `ctl/*/state` does not open `ctl/**`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

from orchestrator.bus.keys import (
    ANY_ESTOP,
    ANY_HOST_STATES,
    ANY_KEPT_ESTOP,
    ANY_OLD_CONTROLLER,
    ANY_STATE,
    ANY_TIME,
    FleetKeys,
)
from orchestrator.bus.service_verbs import VIEW_VERBS
from orchestrator.keys.names import KeyName, Role

OPERATOR_COMMANDS = ("stop", "reset", "jog")
MAINTAINER_COMMANDS = ("raw", "forget")


@dataclass(frozen=True, slots=True)
class Rights:
    """Key expressions of one name, for each kind of act.

    puts: may publish. subscribes: may receive. serves: may declare that it serves, and reply. queries: may request.
    tokens: may announce presence. watches: may watch and list presence. To delete is never allowed: no key is deleted.
    """

    puts: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    queries: tuple[str, ...] = ()
    tokens: tuple[str, ...] = ()
    watches: tuple[str, ...] = ()

    def __add__(self, other: "Rights") -> "Rights":
        return Rights(*((*getattr(self, field.name), *getattr(other, field.name)) for field in fields(self)))


def find_rights(name: KeyName, fleet: str, hosts: Mapping[str, Sequence[str]]) -> Rights:
    """What a name may do in `fleet`. hosts: the controllers of each adapter host, from the fleet file."""
    return _ROLES[name.role](FleetKeys(fleet), name.name, hosts)


def _find_reading(keys: FleetKeys) -> Rights:
    """What all that may look have: every sample, presence, and the requests that change nothing."""
    return Rights(
        subscribes=(keys.everything, ANY_STATE),
        queries=(
            keys.host_states(),
            keys.state(),
            keys.event(),
            keys.info(),
            keys.clock(),
            keys.trace(),
            keys.leases,
            keys.alarm(),
            keys.leader_answer(),
            keys.kept_estop(),
            keys.time,
            ANY_KEPT_ESTOP,
            ANY_STATE,
            ANY_TIME,
            *map(keys.service, VIEW_VERBS),
        ),
        watches=(keys.live(),),
    )


def _find_own(keys: FleetKeys, role: Role, id: str | None) -> Rights:
    """The log, the alarms and the presence of a process under its role. id: its own one; None: any of its role."""
    return Rights(puts=(keys.log(role, id), keys.alarm_request(role, id)), tokens=(keys.live(role, id),))


def _make_coordinator(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    # Its ids on the bus are new with each start, so that they cannot stand here.
    jobs = (keys.job_state(), keys.job_report(), keys.job_begun(), keys.job_plan(), keys.job_samples())
    jobs += (keys.job_points(), keys.job_triggers(), keys.job_live())
    return (
        _find_reading(keys)
        + _find_own(keys, "coordinator", None)
        + Rights(
            puts=(keys.leader, keys.queue, keys.leases, keys.alarm(), keys.virtual(), *jobs),
            serves=(
                keys.service(),
                keys.time,
                keys.leader_answer(),
                keys.leases,
                keys.alarm(),
                keys.kept_estop(),
            ),
            queries=(keys.command(), keys.batch_command()),
        )
    )


def _make_host(keys: FleetKeys, name: str, hosts: Mapping[str, Sequence[str]]) -> Rights:
    rights = (
        _find_reading(keys)
        + _find_own(keys, "host", name)
        + Rights(
            puts=(keys.host_states(name), keys.host_events(name)),
            serves=(keys.served_by_host(name), keys.kept_estop(f"guardian-{name}")),
        )
    )
    for controller in hosts.get(name, ()):
        published_states = (
            keys.state(controller),
            keys.event(controller),
            keys.clock(controller),
            keys.link(controller),
        )
        rights += Rights(
            puts=(*published_states, keys.log("controller", controller)),
            serves=(keys.served_of_controller(controller),),
            tokens=(keys.live("controller", controller),),
        )
    return rights


def _find_operating(keys: FleetKeys) -> Rights:
    commands = (keys.command(None, verb) for verb in OPERATOR_COMMANDS)
    return Rights(puts=(keys.estop, ANY_ESTOP, keys.estop_reset, keys.session()), queries=(keys.service(), *commands))


def _make_operator(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    return _find_reading(keys) + _find_own(keys, "operator", name) + _find_operating(keys)


def _make_maintainer(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    commands = tuple(keys.command(None, verb) for verb in MAINTAINER_COMMANDS)
    own = _find_own(keys, "maintainer", name)
    return _find_reading(keys) + own + _find_operating(keys) + Rights(queries=commands)


def _make_gateway(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    return _find_reading(keys) + _find_own(keys, "gateway", None) + _find_operating(keys)


def _make_viewer(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    return _find_reading(keys)


def _make_recorder(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    return _find_reading(keys) + _find_own(keys, "recorder", None)


def _make_button(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    # It follows the hosts, and waits for the states that confirm the latch.
    return Rights(
        puts=(keys.estop, ANY_ESTOP),
        subscribes=(keys.host_states(), ANY_HOST_STATES, keys.state(), ANY_STATE),
        watches=(keys.live("controller"), ANY_OLD_CONTROLLER),
    )


def _make_router(keys: FleetKeys, name: str, _: Mapping[str, Sequence[str]]) -> Rights:
    """A router keeps the e-stop latch, and looks and stops before it restarts. It carries everything anyway."""
    return _find_reading(keys) + Rights(
        serves=(keys.kept_estop(f"router-{name}"),), queries=(keys.command(None, "stop"), keys.service("stop"))
    )


_ROLES: dict[Role, Callable[[FleetKeys, str, Mapping[str, Sequence[str]]], Rights]] = {
    "coordinator": _make_coordinator,
    "estop-button": _make_button,
    "gateway": _make_gateway,
    "host": _make_host,
    "maintainer": _make_maintainer,
    "operator": _make_operator,
    "recorder": _make_recorder,
    "router": _make_router,
    "viewer": _make_viewer,
}
