# SPDX-License-Identifier: Apache-2.0
"""The stages of the chain, a node for each: the same code as in `perception`, over topics."""
