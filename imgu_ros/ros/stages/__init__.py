# SPDX-License-Identifier: Apache-2.0
"""The stages of the pipeline as nodes of their own: the same code as in `perception`, connected by topics."""
