"""Authenticated encryption with a key that both ends have (ChaCha20-Poly1305, RFC 8439)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tsjepa.live.packet import HEADER, NONCE, Dropped, Header, read_header

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

KEY_BYTES = 32


class Seal:
    """Seals and opens datagrams; without a cipher it passes bodies on as they are.

    The header is authenticated, not encrypted. The nonce is its session and sequence number: sessions are 64 random
    bits and each belongs to one sender and one device, so none comes again under a key.
    """

    def __init__(self, cipher: ChaCha20Poly1305 | None = None) -> None:
        self.cipher = cipher

    def close(self, header: Header, body: bytes = b"") -> bytes:
        """The datagram."""
        if self.cipher is None:
            return header.pack() + body
        head = header._replace(sealed=True).pack()
        return head + self.cipher.encrypt(head[NONCE], body, head)

    def open(self, data: bytes) -> tuple[Header, bytes]:
        """Header and body.

        Raises:
            Dropped: as :func:`tsjepa.live.packet.read_header` does, and "forged" for what was not sealed with this key.
        """
        header = read_header(data)
        head, body = data[: HEADER.size], data[HEADER.size :]
        if header.sealed != (self.cipher is not None):
            raise Dropped("forged")
        if self.cipher is None:
            return header, body
        from cryptography.exceptions import InvalidTag

        try:
            return header, self.cipher.decrypt(head[NONCE], body, head)
        except InvalidTag:
            raise Dropped("forged") from None


def read_key(path: str | None) -> Seal:
    """The seal of the key in a file of 64 hexadecimal digits; one that seals nothing where no file is named.

    Raises:
        ValueError: the file holds something else.
        ModuleNotFoundError: the package cryptography is not installed.
    """
    if path is None:
        return Seal()
    try:
        from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("A key needs the package cryptography: pip install 'tsjepa[device]'.") from error
    try:
        key = bytes.fromhex(Path(path).read_text().strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ValueError(f"{path} holds no key of 64 hexadecimal digits: make one with `openssl rand -hex 32`.")
    return Seal(ChaCha20Poly1305(key))
