"""Faults of a journal in databases: they are slow, or lost, or the machine of one dies, with the leader or without."""

from contextvars import Context
from random import Random

from orchestrator.campaign.injection.repairs import Repair
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.runtime.virtual.databases.site import DatabaseSite
from orchestrator.runtime.virtual.fleet import VirtualFleet

SLOW_NS = (50 * NS_PER_MS, 2 * NS_PER_S)  # more for one commit
PROMOTION_NS = (200 * NS_PER_MS, 4 * NS_PER_S)  # from the death of a primary; not if it is there again before


def require_site(fleet: VirtualFleet) -> DatabaseSite:
    """The databases of a fleet, which has some."""
    assert fleet.site is not None, "the journal of this fleet is a file"
    return fleet.site


def find_leader(fleet: VirtualFleet, otherwise: str) -> str:
    """The coordinator that leads, or led last."""
    leaders = {
        coordinator.leadership.epoch: name
        for name, (process, coordinator) in fleet.coordinators.items()
        if process.alive and coordinator.leadership.epoch and not coordinator.leadership.over
    }
    return leaders[max(leaders)] if leaders else otherwise


def inject_fault(fleet: VirtualFleet, fault: str, leader: str, draw: Random) -> Repair:
    """Inject a fault of the databases; return its repair, after which every coordinator that has ended stands by."""
    site = require_site(fleet)
    match fault:
        case "journal-slow":
            site.commit_ns = draw.randint(*SLOW_NS)
        case "journal-lost":
            for machine in site.machines:
                site.cut(machine, leader)
        case _:
            if fault == "leader-machine-died":
                fleet.kill(f"coordinator/{leader}")
            site.is_silent = draw.random() < 0.5
            _kill_primary(fleet, site, draw.randint(*PROMOTION_NS))

    def repair() -> None:
        site.commit_ns = 0
        for machine in site.machines:
            site.join(machine, leader)
            site.revive(machine)
        for name, (process, _) in list(fleet.coordinators.items()):
            if not process.alive:
                fleet.start_coordinator(name, standby=True)

    return repair


def _kill_primary(fleet: VirtualFleet, site: DatabaseSite, after_ns: int) -> None:
    dead = site.primary
    site.kill(dead)

    def promote() -> None:
        successor = site.find_successor()
        if site.primary == dead and not site.answers(dead, "") and successor is not None:
            site.promote(successor)

    fleet.clock.call_at_ns(fleet.clock.now_ns() + after_ns, promote, context=Context())
