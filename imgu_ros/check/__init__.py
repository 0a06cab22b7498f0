# SPDX-License-Identifier: Apache-2.0
"""How good a target is, before anything is printed: what can be seen of it beforehand, and in simulated views."""
