# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/PointCloud2 <-> structured arrays: tables whose columns have names, types and counts."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import EncodingError
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.messages.image import data_bytes
from imgu_ros.shown_text import quoted

#: A structured array, (N,): one row for each point, one field for each column.
Table = NDArray[np.void]

#: sensor_msgs/PointField's numbers for data types.
_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_DTYPES = {number: code for code, number in _DATATYPES.items()}


def point_cloud_message(make: MessageFactory, header: Header, table: Table) -> Any:
    """Return a sensor_msgs/PointCloud2 of one row (height 1), in the layout of the array; padding is zero.

    Parameters
    ----------
    table : (N,) structured, N >= 0; each field a number or a one-dimensional array of numbers, native byte order

    Raises
    ------
    EncodingError
        If a field has a type that PointField does not know.
    """
    dtype = table.dtype
    if table.ndim != 1 or not dtype.names:
        raise EncodingError(f"table: shape {table.shape}, fields {dtype.names}; need (N,) with named fields")
    # Column by column: numpy may leave whatever was in memory between the columns.
    rows = np.zeros(len(table), dtype)
    for name in dtype.names:
        rows[name] = table[name]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header_message(make, header),
        height=1,
        width=len(table),
        fields=list(_fields(make, dtype)),
        is_bigendian=sys.byteorder == "big",
        point_step=dtype.itemsize,
        row_step=dtype.itemsize * len(table),
        data=rows.view(np.uint8),
        is_dense=True,
    )


def decode_point_cloud(message: Any) -> Table:
    """Read a sensor_msgs/PointCloud2 of any layout and byte order.

    Returns
    -------
    (height * width,) structured, native byte order, row by row

    Raises
    ------
    EncodingError
        If a field's type is unknown, its name repeats, it lies outside its point, or the data are too short.
    """
    width, height = int(message.width), int(message.height)
    point_step, row_step = int(message.point_step), int(message.row_step)
    dtype = _dtype(message, point_step)
    data = data_bytes(message)
    if width < 0 or height < 0 or (height > 1 and row_step < width * point_step):
        raise EncodingError(
            f"point cloud: {width} x {height} points of {point_step} bytes, row_step {row_step}; "
            f"need row_step >= {width * point_step}"
        )
    if width == 0 or height == 0:
        return np.empty(0, dtype.newbyteorder("="))
    needed = row_step * (height - 1) + point_step * width
    if len(data) < needed:
        raise EncodingError(f"point cloud: {len(data)} bytes; need {needed} for {width} x {height} points")
    table: Table = np.ndarray((height, width), dtype, buffer=data, strides=(row_step, point_step))
    return table.reshape(-1).astype(dtype.newbyteorder("="))


@lru_cache(maxsize=64)
def _fields(make: MessageFactory, dtype: np.dtype[Any]) -> tuple[Any, ...]:
    """Return the fields' messages, the same objects for all clouds of a layout: they are never changed."""
    return tuple(_field(make, dtype, name) for name in dtype.names or ())


def _field(make: MessageFactory, dtype: np.dtype[Any], name: str) -> Any:
    column, offset = _columns(dtype)[name][:2]
    base, shape = column.subdtype or (column, (1,))
    datatype = _DATATYPES.get(base.str[1:]) if base.isnative and len(shape) == 1 else None
    if datatype is None:
        raise EncodingError(f"field {name}: {column}; need native numbers of {', '.join(_DATATYPES)}, or a row of them")
    return make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=shape[0])


def _columns(dtype: np.dtype[Any]) -> Mapping[str, Any]:
    return dtype.fields if dtype.fields is not None else {}


def _dtype(message: Any, point_step: int) -> np.dtype[Any]:
    order = ">" if message.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for field in message.fields:
        name, offset, count = str(field.name), int(field.offset), int(field.count)
        code = _DTYPES.get(int(field.datatype))
        if code is None or name in names or name == "" or count < 0:
            raise EncodingError(
                f"point cloud: field {quoted(name)}, datatype {field.datatype}, count {count}; "
                f"need a new name, datatype 1 to {len(_DTYPES)}, count >= 0"
            )
        # A count of 0 is what drivers leave where they mean one.
        base = np.dtype(order + code)
        if not 0 <= offset <= point_step - base.itemsize * max(1, count):
            raise EncodingError(
                f"point cloud: field {quoted(name)} at byte {offset}; need it within {point_step} bytes"
            )
        names.append(name)
        formats.append(base if count <= 1 else np.dtype((base, (count,))))
        offsets.append(offset)
    if not names:
        raise EncodingError("point cloud: no fields; need at least one")
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step})
