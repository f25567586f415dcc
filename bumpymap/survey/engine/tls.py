"""TLS connections to a scheduler: reading the certificates, and the warning about a connection without TLS."""

import ssl
from dataclasses import dataclass, fields
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from bumpymap.core import UsageError, read_regular, read_settings_file

__all__ = ["TlsSettings", "read_tls_settings", "warning_without_tls"]


@dataclass(frozen=True, slots=True)
class TlsSettings:
    """PEM files. Scheduler, workers and client trust each other if one authority signed all their certificates."""

    ca: Path
    """Certificate of the authority."""
    cert: Path
    """Certificate of this client, signed by the authority."""
    key: Path
    """Key of this client's certificate, without a passphrase."""


def read_tls_settings(path: Path) -> TlsSettings:
    """Read a settings file (``tls_config``) and check that its certificates can be used.

    Raises
    ------
    UsageError
        The file, or one that it names, cannot be read or has the wrong content.
    """
    given = read_settings_file(path, TlsSettings)
    names = [field.name for field in fields(TlsSettings)]
    missing = [name for name in names if name not in given]
    if missing:
        raise UsageError(
            f'{path} does not name {", ".join(missing)}. It takes {", ".join(names)}, such as ca = "ca.pem"'
        )
    settings = TlsSettings(**given)
    for name in names:
        _refuse_unreadable(path, name, getattr(settings, name))
    context = ssl.create_default_context()
    try:
        context.load_verify_locations(settings.ca)
    except ssl.SSLError as error:
        raise UsageError(f"{path}: ca = {settings.ca} holds no certificate in PEM format ({_reason(error)})") from error
    try:
        context.load_cert_chain(settings.cert, settings.key, password="")  # do not ask for a passphrase
    except ssl.SSLError as error:
        raise UsageError(
            f"{path}: cert = {settings.cert} and key = {settings.key} do not work together ({_reason(error)}). They "
            "are a certificate and its own key, in PEM format, the key without a passphrase"
        ) from error
    return settings


def warning_without_tls(address: str) -> str | None:
    """Return a warning if a scheduler on another machine is used without TLS; else None."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme == "tls" or _is_loopback(parts.hostname or ""):
        return None
    return (
        f"{address} is used without TLS: whoever reaches that port can run programs as the user of the scheduler and "
        "the workers, and read and change what they are sent. On a network that others use too, start them with TLS "
        "and give a tls:// address and `tls_config`"
    )


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _refuse_unreadable(path: Path, name: str, file: Path) -> None:
    try:
        read_regular(file)
    except OSError as error:
        raise UsageError(f"{path}: {name} = {file} cannot be read: {error.strerror or error}") from error


def _reason(error: ssl.SSLError) -> str:
    return (error.reason or str(error)).replace("_", " ").lower()
