"""Which hosts of an address answer: a computer that is dead answers nothing, and each attempt to connect to it would
take two seconds, for as long as it is dead."""

from psycopg.conninfo import conninfo_to_dict, make_conninfo

from orchestrator.bus.hosts_live import Host, find_living

DEFAULT_PORT = "5432"


def list_hosts(conninfo: str) -> list[Host]:
    """The hosts, as libpq takes them; none where libpq has their addresses from elsewhere."""
    parts = conninfo_to_dict(conninfo)
    if "hostaddr" in parts or not parts.get("host"):
        return []
    names, ports = str(parts["host"]).split(","), str(parts.get("port") or DEFAULT_PORT).split(",")
    ports = ports if len(ports) > 1 else ports * len(names)
    return [Host(name, port or DEFAULT_PORT) for name, port in zip(names, ports, strict=True)]


def put_living_first(conninfo: str, limit_s: float) -> str:
    """The same address, its hosts that take connections before those that are silent or refuse. Takes `limit_s` at
    most, besides the resolution of names; nothing with one host."""
    hosts = list_hosts(conninfo)
    if len(hosts) < 2:
        return conninfo
    living_hosts = find_living(hosts, limit_s)
    hosts.sort(key=lambda host: host not in living_hosts)
    host_parts = {"host": ",".join(host.name for host in hosts), "port": ",".join(host.port for host in hosts)}
    return make_conninfo(conninfo, **host_parts)


def takes_connections(conninfo: str, limit_s: float) -> bool:
    """Whether one of the hosts takes a connection in time; True where that cannot be asked."""
    hosts = list_hosts(conninfo)
    return not hosts or bool(find_living(hosts, limit_s))
