"""Who may look: nobody but this machine, or whoever has the token."""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass
from urllib.parse import urlsplit


@dataclass(frozen=True)
class Access:
    """What a request has to bring along; without a `token` only this machine is listened to.

    A page of somebody else's may name this machine in its requests (DNS rebinding, cross-site
    WebSockets), which is why names and origins are looked at even there.
    """

    token: str | None = None

    def takes_host(self, host: str) -> bool:
        """Whether a request's Host is a name of this machine; any is, where a token is asked."""
        return self.token is not None or is_local(_hostname(host))

    def takes_origin(self, origin: str | None, host: str) -> bool:
        """Whether a request comes from the page itself; what is no browser tells no origin."""
        return origin is None or urlsplit(origin).netloc.lower() == host.lower()

    def admits(self, token: str | None) -> bool:
        """Whether the token is the right one, in a time that does not tell how much of it is."""
        if self.token is None:
            return True
        return hmac.compare_digest((token or "").encode(), self.token.encode())


def is_local(host: str) -> bool:
    """Whether a name or address is that of this machine to itself."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _hostname(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
