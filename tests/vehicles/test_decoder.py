"""What is decoded of what arrives: all that the rules judge by, and only so much of the rest."""

from __future__ import annotations

import pytest
from fuzz import BEAT, packed
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.vehicles.mavlink.client.link.traffic import NEEDED, OTHERS_HZ, MessageDecoder, number_of

TEXT = m.MAVLink_statustext_message(3, b"again")
NAMES = {
    *("HEARTBEAT", "SYS_STATUS", "ATTITUDE", "LOCAL_POSITION_NED", "RC_CHANNELS", "COMMAND_ACK", "TIMESYNC"),
    *("POSITION_TARGET_LOCAL_NED", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "EXTENDED_SYS_STATE"),
}


def test_what_is_always_decoded_is_what_the_rules_judge_by():
    assert {m.mavlink_map[number].msgname for number in NEEDED} == NAMES


@pytest.mark.parametrize("old", [True, False])
def test_the_number_of_a_packet_is_read_without_decoding_it(old):
    for message in (BEAT, TEXT, m.MAVLink_extended_sys_state_message(0, 1)):
        packet = bytes(message.pack(m.MAVLink(None), force_mavlink1=old))
        assert number_of(packet) == message.get_msgId()
        assert number_of(packet + b"\0") is None
        assert number_of(packet[:-1]) is None
    assert number_of(b"") is None


def test_a_signed_packet_is_read_as_well():
    mav = m.MAVLink(None)
    mav.signing.secret_key, mav.signing.sign_outgoing = b"k" * 32, True
    assert number_of(bytes(TEXT.pack(mav))) == 253


def test_a_flood_of_texts_is_dropped_and_every_heartbeat_between_them_is_decoded():
    decoder, texts, beats = MessageDecoder(datagrams=True), 0, 0
    for step in range(5000):
        now = 100 + step / 5000
        texts += len(list(decoder.messages(packed(TEXT), now)))
        if step % 10 == 0:
            beats += len(list(decoder.messages(packed(BEAT), now)))
    assert beats == 500
    assert OTHERS_HZ <= texts <= 2 * OTHERS_HZ + 1
    assert decoder.dropped == 5000 - texts
    parameter = packed(m.MAVLink_param_value_message(b"FS_OPTIONS", 16.0, 9, 1, 0))
    assert len(list(decoder.messages(parameter, 101.0))) == 1  # another kind
    assert len(list(decoder.messages(packed(TEXT), 102.0))) == 1


def test_a_stream_is_decoded_across_its_reads():
    decoder, data = MessageDecoder(datagrams=False), packed(BEAT) + packed(TEXT)
    found = [message.get_type() for byte in data for message in decoder.messages(bytes([byte]), 0.0)]
    assert found == ["HEARTBEAT", "STATUSTEXT"]
