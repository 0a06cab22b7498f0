# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
import struct

import numpy as np
import pytest

from imgu_ros.errors import EncodingError
from imgu_ros.messages.header import Header
from imgu_ros.messages.point_cloud import decode_point_cloud, point_cloud_message

HEADER = Header(1_500_000_000, "camera")
INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64 = range(1, 9)


def described(message) -> list[tuple[str, int, int, int]]:
    return [(field.name, field.offset, field.datatype, field.count) for field in message.fields]


def cloud(make, fields, data: bytes, **changes):
    made = [
        make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=count)
        for name, offset, datatype, count in fields
    ]
    return make("sensor_msgs/msg/PointCloud2", fields=made, data=np.frombuffer(data, np.uint8), **changes)


def test_layout_and_bytes(make):
    table = np.zeros(2, np.dtype([("a", "i4"), ("b", "f8", (2,)), ("c", "u1"), ("d", "f4")], align=True))
    table[0] = (-1, (0.5, 1e300), 7, 2.5)
    table[1] = (2, (-0.25, 3.0), 255, -1.0)
    message = point_cloud_message(make, HEADER, table)
    assert described(message) == [("a", 0, INT32, 1), ("b", 8, FLOAT64, 2), ("c", 24, UINT8, 1), ("d", 28, FLOAT32, 1)]
    assert (message.width, message.height, message.point_step, message.row_step) == (2, 1, 32, 64)
    assert not message.is_bigendian
    assert message.is_dense
    expected = struct.pack("<i4xddB3xf", -1, 0.5, 1e300, 7, 2.5) + struct.pack("<i4xddB3xf", 2, -0.25, 3.0, 255, -1.0)
    assert bytes(message.data) == expected
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    again = decode_point_cloud(message)
    for name in table.dtype.names:
        np.testing.assert_array_equal(again[name], table[name])


@pytest.mark.parametrize("order", ["<", ">"])
def test_every_datatype_in_both_byte_orders(make, order):
    codes = {INT8: "b", UINT8: "B", INT16: "h", UINT16: "H", INT32: "i", UINT32: "I", FLOAT32: "f", FLOAT64: "d"}
    values = {
        INT8: -5,
        UINT8: 250,
        INT16: -3000,
        UINT16: 60000,
        INT32: -(2**30),
        UINT32: 2**31,
        FLOAT32: 0.5,
        FLOAT64: 1e99,
    }
    fields, data, offset = [], b"", 0
    for datatype, code in codes.items():
        fields.append((f"f{datatype}", offset, datatype, 1))
        data += struct.pack(order + code, values[datatype])
        offset = len(data)
    message = cloud(
        make, fields, data, width=1, height=1, point_step=offset, row_step=offset, is_bigendian=order == ">"
    )
    table = decode_point_cloud(message)
    assert table.dtype.isnative
    for datatype in codes:
        assert table[f"f{datatype}"][0] == values[datatype]


def test_padded_rows_and_gaps_between_fields(make):
    # Two rows of two points; x at byte 4 of 12, rows of 30 bytes.
    points = [struct.pack("<4xf4x", value) for value in (1.0, 2.0, 3.0, 4.0)]
    data = points[0] + points[1] + b"\xff" * 6 + points[2] + points[3]
    message = cloud(make, [("x", 4, FLOAT32, 0)], data, width=2, height=2, point_step=12, row_step=30)
    np.testing.assert_array_equal(decode_point_cloud(message)["x"], [1, 2, 3, 4])


def test_no_points(make):
    table = np.zeros(0, np.dtype([("x", "f4"), ("d", "u1", (32,))]))
    again = decode_point_cloud(point_cloud_message(make, HEADER, table))
    assert again.shape == (0,)
    assert again["d"].shape == (0, 32)


@pytest.mark.parametrize(
    ("fields", "changes", "says"),
    [
        ([], {}, "no fields"),
        ([("x", 0, 9, 1)], {}, "datatype 9"),
        ([("x", 0, 0, 1)], {}, "datatype 0"),
        ([("x", 0, FLOAT32, 1), ("x", 4, FLOAT32, 1)], {}, "need a new name"),
        ([("x", 6, FLOAT32, 1)], {}, "field 'x' at byte 6; need it within 8 bytes"),
        ([("x", 0, FLOAT32, 3)], {}, "need it within 8 bytes"),
        ([("x", 0, FLOAT32, 2**32 - 1)], {}, "need it within 8 bytes"),
        ([("x", 0, FLOAT32, 1)], {"width": 5}, "point cloud: 32 bytes; need 40"),
        ([("x", 0, FLOAT32, 1)], {"width": 2**32 - 1, "row_step": 2**32 - 1}, "point cloud: 32 bytes"),
        ([("x", 0, FLOAT32, 1)], {"height": 2, "row_step": 8}, "need row_step >= 32"),
    ],
)
def test_hostile_clouds(make, fields, changes, says):
    described = {"width": 4, "height": 1, "point_step": 8, "row_step": 32} | changes
    with pytest.raises(EncodingError, match=re.escape(says)):
        decode_point_cloud(cloud(make, fields, bytes(32), **described))


def test_encoder_refuses_other_types(make):
    for dtype in ([("x", "i8")], [("x", ">f4")], [("x", "f4", (2, 2))], "f4"):
        with pytest.raises(EncodingError, match="need"):
            point_cloud_message(make, HEADER, np.zeros(1, dtype))
