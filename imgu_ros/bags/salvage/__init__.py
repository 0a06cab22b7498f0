# SPDX-License-Identifier: Apache-2.0
"""Find and read messages in MCAP, ROS 1 and SQLite files in any state, in bounded memory and time.

Intact MCAP files and ROS 1 bags are read here too, because rosbags and mcap would cost replay more time per image and
none of the bounds: `benchmarks/bag_readers.py` compares the three.
"""
