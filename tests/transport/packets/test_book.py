"""The book's slots are told apart, and the ledger is made of them alone."""

import dis
from dataclasses import fields

import numpy as np

import lfmesh as lf
from lfmesh.transport.packets.book import ABSORBED, FIXED, LOST, LOST_IN, Book
from lfmesh.transport.packets.packet import EVENT_OF_STATUS, PACKET, Event, put

BOOK = Book.of_bodies(2, ["chart", "ball"], ["the air before the lens", "lens[0]", "the air behind the lens"])


def test_every_slot_adds_to_a_field_of_the_ledger() -> None:
    known = {field.name for field in fields(lf.Ledger)}
    assert {slot.account for slot in BOOK.slots} <= known
    assert len({(slot.name, slot.account) for slot in FIXED}) == len(FIXED)


def test_each_entry_is_in_the_ledger_once_under_its_own_name() -> None:
    entries = 2.0 ** np.arange(len(BOOK))
    ledger = BOOK.ledger(entries, "W", packets=7)
    numbers = [getattr(ledger, slot.account) for slot in BOOK.slots if slot.account not in (ABSORBED, LOST, LOST_IN)]
    listed = [*ledger.absorbed.values(), *ledger.lost.values(), *ledger.lost_in.values()]
    # Powers of two: only if each is there once, and none twice, is this the sum.
    assert sum(numbers) + sum(listed) == entries.sum()
    assert ledger.absorbed["chart"] == entries[BOOK.targets[0]]
    assert ledger.absorbed["lens[1] edge"] == entries[BOOK.edges[1]]
    assert ledger.lost_in["ball"] == entries[BOOK.lost_in_targets[1]]
    assert ledger.lost_in["lens[0]"] == entries[BOOK.lost_in_spaces[1]]
    assert ledger.packets == 7


def test_bodies_of_one_name_share_a_line() -> None:
    book = Book.of_bodies(0, ["ball", "ball"], [])
    entries = np.zeros(len(book))
    entries[book.targets] = [1.0, 2.0]
    assert book.ledger(entries, "W").absorbed["ball"] == 3.0


def test_every_status_has_the_event_of_its_name() -> None:
    for status in lf.Status:
        if status is not lf.Status.ROULETTE:
            assert Event(EVENT_OF_STATUS[status]).name == status.name


def test_a_queued_packet_has_every_field() -> None:
    """`put` writes all fields by name, as a copy of the record would be slower: none may be forgotten."""
    written = {step.argval for step in dis.get_instructions(put.py_func) if step.opname == "STORE_ATTR"}
    fields = PACKET.fields or {}
    assert written <= set(fields)
    # Two fields may share a place; written by one, it is written.
    assert {fields[name][1] for name in written} == {field[1] for field in fields.values()}
