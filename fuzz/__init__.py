# SPDX-License-Identifier: Apache-2.0
"""Structure-aware fuzzing of everything that reads files: `python -m fuzz --help`, CONTRIBUTING.md."""
