"""Who may look."""

from __future__ import annotations

import pytest

from turbseg_ros.view.access import Access, is_local

HERE = Access()
ANYWHERE = Access("secret")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:8080", "127.0.0.1:9", "[::1]:8080"])
def test_names_of_this_machine_are_taken(host: str) -> None:
    assert HERE.takes_host(host)


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "localhost.evil.example",
        "192.0.2.1",
        "",
        "[",
        "0.0.0.0",
        "127.0.0.1.nip.io",
    ],
)
def test_other_names_are_taken_only_where_a_token_is_asked(host: str) -> None:
    assert not HERE.takes_host(host)
    assert ANYWHERE.takes_host(host)


def test_pages_of_others_may_not_talk() -> None:
    for access in (HERE, ANYWHERE):
        assert access.takes_origin("http://localhost:8080", "localhost:8080")
        assert access.takes_origin(None, "localhost:8080")
        assert not access.takes_origin("http://evil.example", "localhost:8080")
        assert not access.takes_origin("http://localhost:9090", "localhost:8080")
        assert not access.takes_origin("null", "localhost:8080")


@pytest.mark.parametrize("token", [None, "", "secre", "secret ", "sécret", "Secret"])
def test_only_the_token_itself_opens(token: str | None) -> None:
    assert ANYWHERE.admits("secret")
    assert not ANYWHERE.admits(token)
    assert HERE.admits(token)


def test_addresses_of_this_machine_to_itself_are_known() -> None:
    assert all(map(is_local, ("localhost", "127.0.0.1", "127.1.2.3", "::1")))
    assert not any(map(is_local, ("0.0.0.0", "::", "192.0.2.1", "", "camera-box")))
