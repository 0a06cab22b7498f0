# SPDX-License-Identifier: Apache-2.0
"""The package for pip and for colcon (ament_python). Name, version and description come from package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

# colcon's --symlink-install runs a link to this file from another folder.
HERE = Path(__file__).resolve().parent
MANIFEST = ElementTree.parse(HERE / "package.xml").getroot()
NAME = MANIFEST.findtext("name")


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """Return what setuptools calls data files: everything in `folder`, for share/imgu_ros/`folder`."""
    paths = sorted(path.relative_to(HERE) for path in (HERE / folder).rglob("*") if path.is_file())
    paths = [path for path in paths if "__pycache__" not in path.parts]
    parents = sorted({path.parent for path in paths})
    return [(f"share/{NAME}/{parent}", [str(path) for path in paths if path.parent == parent]) for parent in parents]


setup(
    name=NAME,
    version=MANIFEST.findtext("version"),
    description=MANIFEST.findtext("description"),
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer=MANIFEST.findtext("maintainer"),
    maintainer_email=MANIFEST.find("maintainer").get("email"),
    license="Apache-2.0",
    project_urls={item.get("type"): item.text for item in MANIFEST.findall("url")},
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed", "*.xml", "templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared("config"),
        *shared("launch"),
    ],
    entry_points={"console_scripts": ["imgu = imgu_ros.cli.main:main"]},
    zip_safe=False,
    install_requires=[
        "av>=12",  # reads video files
        'backports.zstd>=1.0; python_version < "3.14"',
        "jinja2>=3.1",
        "lz4>=4.0",
        "markupsafe>=2.0",
        "matplotlib>=3.6",
        "numpy>=1.26",
        "opencv-python-headless>=4.6",
        "pillow>=10.0",  # when a picture was taken
        "PyYAML>=6.0",
        "rosbags>=0.11",
        "scipy>=1.11",
        "shtab>=1.8",  # makes tab completion
        "tqdm>=4.66",
    ],
    extras_require={
        # What benchmarks/ compares with.
        "bench": ["colour-demosaicing>=0.2.6"],
        # The path tracer of benchmarks/foreign_frames.py; it needs the shared library of LLVM too (apt: libllvm19).
        "foreign": ["mitsuba>=3.9"],
        # Wheels for x86-64 Linux; elsewhere ROS 2 Jazzy comes from apt (README.md). Without `fastrtps` there is no
        # middleware, and importing rclpy fails.
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        # What scripts/audit and scripts/sbom check with.
        "supply": ["cyclonedx-python-lib[json-validation]>=8", "pip-audit>=2.7"],
        "test": [
            "coverage>=7.4",
            "hypothesis>=6.98",
            "mcap>=1.2",
            "mcap-ros2-support>=0.5",
            "mypy>=1.11",
            "pypdfium2>=4.30",
            "pytest>=7.4",
            "pytest-cov>=5",
            "pytest-timeout>=2.2",
            "pytest-xdist>=3.5",
            "ruff>=0.6",
            "types-PyYAML",
            "types-tqdm",
        ],
        # The viewer of `imgu view`. It needs NumPy 2.
        "view": ["rerun-sdk>=0.41"],
    },
    classifiers=[
        "Intended Audience :: Developers",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Programming Language :: Python :: 3.14",
        "Topic :: Scientific/Engineering :: Image Recognition",
        "Typing :: Typed",
    ],
)
