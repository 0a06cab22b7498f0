# SPDX-License-Identifier: Apache-2.0
"""Demosaicking methods, one to a file; `imgu_ros.vision.formation.demosaic.demosaic` chooses among them."""
