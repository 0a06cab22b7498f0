# SPDX-License-Identifier: Apache-2.0
"""Import every installed module of the package that needs no ROS and no optional dependency."""

from __future__ import annotations

import importlib
import pkgutil
import sys

import imgu_ros

#: Below imgu_ros: the nodes, and what the extra `view` is for.
OPTIONAL = ("imgu_ros.ros.", "imgu_ros.view.rerun_")

names = [module.name for module in pkgutil.walk_packages(imgu_ros.__path__, "imgu_ros.")]
for name in names:
    if not name.startswith(OPTIONAL):
        importlib.import_module(name)
print(f"Python {sys.version.split()[0]}: {len(names)} modules")
