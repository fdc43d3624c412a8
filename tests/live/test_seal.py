"""With a key nothing is taken that was not sealed with it."""

import sys

import pytest

from tsjepa.live.packet import HEADER, UPDATE, Dropped, Header
from tsjepa.live.seal import Seal, read_key

HEAD = Header(UPDATE, 1, 2, 3, 4, 5, 6)


@pytest.fixture
def seal(tmp_path):
    (tmp_path / "key").write_text("ab" * 32 + "\n")
    return read_key(str(tmp_path / "key"))


def test_what_is_sealed_opens_and_cannot_be_read_meanwhile(seal):
    data = seal.close(HEAD, b"a secret payload")
    assert len(data) == HEADER.size + 16 + 16
    assert b"secret" not in data
    assert seal.open(data) == (HEAD._replace(sealed=True), b"a secret payload")


def test_a_single_changed_bit_is_noticed_wherever_it_is(seal):
    data = seal.close(HEAD, b"payload")
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(Dropped):
            seal.open(bytes(changed))
    for size in range(len(data)):
        with pytest.raises(Dropped):
            seal.open(data[:size])


def test_another_key_and_no_key_are_refused(seal, tmp_path):
    (tmp_path / "other").write_text("cd" * 32)
    for other in (read_key(str(tmp_path / "other")), Seal()):
        with pytest.raises(Dropped, match="forged"):
            seal.open(other.close(HEAD, b"payload"))
        with pytest.raises(Dropped, match="forged"):
            other.open(seal.close(HEAD, b"payload"))


def test_no_two_packets_have_the_same_nonce(seal):
    body = bytes(16)
    sealed = [
        seal.close(HEAD._replace(session=session, sequence=n), body)[HEADER.size :]
        for session, n in [(2, 3), (2, 4), (3, 3)]
    ]
    assert len(set(sealed)) == 3


@pytest.mark.parametrize("content", ["", "ab" * 31, "xy" * 32, "ab" * 33])
def test_a_file_that_holds_no_key_is_refused_in_one_sentence(tmp_path, content):
    (tmp_path / "key").write_text(content)
    with pytest.raises(ValueError, match="no key of 64 hexadecimal digits: make one with `openssl rand -hex 32`"):
        read_key(str(tmp_path / "key"))


def test_without_the_package_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "key").write_text("ab" * 32)
    monkeypatch.setitem(sys.modules, "cryptography.hazmat.primitives.ciphers.aead", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'tsjepa\[device\]'"):
        read_key(str(tmp_path / "key"))
    assert read_key(None).close(HEAD, b"x") == HEAD.pack() + b"x"
