"""Clients name what is wrong with a server's certificate at once; trying again does not mend it."""

import ssl
from pathlib import Path

import pytest
from policy_clients import openpi_server

from cognitivedrone.errors import ServerError
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.remote.connection import Connection
from cognitivedrone.remote.faults import tls_fault
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving

CERTIFICATES = Path(__file__).parents[1] / "support" / "certificates"
"""With their keys, of no use elsewhere: for this machine; for another name; for a day of 2020."""


def shown(name: str) -> ssl.SSLContext:
    """A server's side of TLS, with a certificate that only it trusts."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(CERTIFICATES / f"{name}.pem")
    return context


@pytest.fixture(autouse=True)
def _trusting_nothing(monkeypatch):
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)


@pytest.fixture
def refused(monkeypatch):
    """What a policy's check says of the server at an address, which it tries once only."""
    tried, connect = [], Connection._connect

    def try_once(self):
        tried.append(self.url)
        return connect(self)

    monkeypatch.setattr(Connection, "_connect", try_once)

    def check(address: str) -> str:
        policy = make_policy(f"remote:wss://{address}")
        with pytest.raises(ServerError) as refusal:
            policy.check()
        policy.close()
        assert tried == [f"wss://{address}"]
        return str(refusal.value)

    return check


def test_a_certificate_that_nobody_vouches_for_is_named_at_once(refused):
    with openpi_server(lambda _: {}, tls=shown("localhost")) as address:
        said = refused(address)
    assert said.startswith(f"the policy server at wss://{address} shows a certificate that this machine does not trust")
    assert "self" in said
    assert said.endswith("set SSL_CERT_FILE to that file")


def test_the_way_out_works(monkeypatch):
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATES / "localhost.pem"))
    with openpi_server(lambda _: {}, {"cognitivedrone": {"protocol": 1}}, shown("localhost")) as address:
        policy = make_policy(f"remote:wss://{address}")
        policy.check()
        policy.close()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("elsewhere", "shows a certificate for another name ("),
        ("expired", "shows a certificate that has expired; renew it on the server, or correct this machine's clock"),
    ],
)
def test_a_certificate_for_another_name_or_time_is_named_at_once(name, says, refused, monkeypatch):
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATES / f"{name}.pem"))
    with openpi_server(lambda _: {}, tls=shown(name)) as address:
        assert says in refused(address)


def test_a_server_without_tls_is_named_at_once(refused):
    with serving(ServePlan.of(policy="hover", port=0)) as address:
        assert "if it speaks none, its address begins with ws://" in refused(str(address))


def test_the_reasoner_behind_a_chat_api_names_it_too(monkeypatch):
    pytest.importorskip("httpx")
    with openpi_server(lambda _: {}, tls=shown("localhost")) as address:
        reasoner = make_reasoner(f"vlm:https://{address},model=m")
        with pytest.raises(ServerError, match=r"the VLM server at .* shows a certificate that this machine does not"):
            reasoner.check()
        reasoner.close()
        monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATES / "localhost.pem"))
        reasoner = make_reasoner(f"vlm:https://{address},model=m")
        with pytest.raises(ServerError, match="answers 426"):  # it speaks websocket alone
            reasoner.check()
        reasoner.close()


@pytest.mark.parametrize("error", [ssl.SSLEOFError(8, "EOF"), ConnectionResetError(104, "reset"), TimeoutError()])
def test_what_may_pass_is_no_fault_of_tls(error):
    assert tls_fault(error) == ""
