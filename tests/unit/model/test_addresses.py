"""Addresses that programs read differently, and network addresses of serial ports, are refused with what to write."""

import pytest
from pydantic import TypeAdapter, ValidationError

from orchestrator.bus.endpoint import BadEndpoint, check_endpoint
from orchestrator.model.links import Link
from orchestrator.model.text.addresses import check_host

LINKS: TypeAdapter[Link] = TypeAdapter(Link)


@pytest.mark.parametrize(
    "text", ["192.168.1.20", "0.0.0.0", "localhost", "lab2", "abc1", "cafe", "a.b.c", "fe80::1", "10-20", "x.1a"]
)
def test_a_plain_address_is_kept(text: str) -> None:
    assert check_host(text) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("192.168.001.020", "octal; write 192.168.1.20"),
        ("010.0.0.1", "octal; write 10.0.0.1"),
        (" 192.168.1.20", "has a space; remove it"),
        ("lab 2", "has a space; remove it"),
        ("10.1", "is no address"),
        ("3232235796", "is no address"),
        ("0x7f.0.0.1", "is no address"),
        ("192.168.1.300", "is no address"),
    ],
)
def test_an_ambiguous_address_is_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_host(text)
    for kind in ("tcp", "udp"):
        with pytest.raises(ValidationError, match=words):
            LINKS.validate_python({"kind": kind, "host": text, "port": 23})
    if " " not in text:
        with pytest.raises(BadEndpoint, match=words):
            check_endpoint(f"tcp/{text}:7447")


@pytest.mark.parametrize("device", ["rfc2217://192.168.1.30:4001", "socket://terminal:4001"])
def test_a_serial_port_of_a_network_is_refused_with_the_way_that_works(device: str) -> None:
    with pytest.raises(ValidationError, match=r"kind: tcp, host: …, port: …"):
        LINKS.validate_python({"kind": "serial", "device": device})
