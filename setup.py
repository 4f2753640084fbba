"""Build of the turbseg_ros package, by pip and by colcon alike."""

import ast
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "turbseg_ros"

EXECUTABLES = (
    "node",
    "play",
    "replay",
    "record",
    "evaluate",
    "simulate",
    "train",
    "import",
    "benchmark",
    "view",
)


def _version() -> str:
    """Read `__version__` without importing the package, whose needs are not there yet."""
    module = ast.parse(Path(PACKAGE, "__init__.py").read_text(encoding="utf-8"))
    (value,) = (
        node.value
        for node in module.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__version__"
    )
    return str(ast.literal_eval(value))


def _files(folder: str) -> list[str]:
    return sorted(str(path) for path in Path(folder).iterdir() if path.is_file())


setup(
    name=PACKAGE,
    version=_version(),
    description="Live segmentation of moving objects seen through atmospheric turbulence.",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    url="https://example.com/turbseg_ros",
    project_urls={
        "Source": "https://example.com/turbseg_ros.git",
        "Issues": "https://example.com/turbseg_ros/issues",
    },
    author="turbseg_ros maintainers",
    author_email="maintainers@example.com",
    maintainer="turbseg_ros maintainers",
    maintainer_email="maintainers@example.com",
    license="Apache-2.0",
    # Said aloud, so that an editable installation is a plain path, which type checkers follow too.
    package_dir={"": "."},
    packages=find_packages(include=[f"{PACKAGE}*"]),
    package_data={
        PACKAGE: ["py.typed", "evaluation/*.jinja", "learning/weights/*", "view/page/*"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", _files("config")),
        (f"share/{PACKAGE}/launch", _files("launch")),
    ],
    python_requires=">=3.10",
    install_requires=[
        "setuptools>=64",
        "numpy>=1.26,<3",
        "scipy>=1.11,<2",
        "PyYAML>=6,<7",
        "tqdm>=4.60,<5",
    ],
    extras_require={
        # What a machine without ROS 2 takes from the package registry; a ROS machine has these
        # from its own distribution (package.xml), under other package names.
        "wheels": [
            "ros-jazzy-rclpy>=7.1,<8",
            "ros-jazzy-common-interfaces>=5.3,<6",
            "ros-jazzy-rmw-fastrtps-cpp>=8.4,<9",
            "ros-wheels-bootstrapper>=0.1,<1",
            "opencv-python-headless>=4.6,<6",
        ],
        # RAFT, and training; the pretrained network runs by OpenCV.
        "learning": [
            "torch>=2.1,<3",
            "torchvision>=0.16,<1",
            "safetensors>=0.4,<1",
            "onnx>=1.15,<2",
            "onnxscript>=0.1,<1",
        ],
        "bags": ["mcap>=1.2.1,<2"],
        # Reports and curves.
        "evaluation": ["jinja2>=3.1,<4"],
        # The page that shows a running node.
        "view": ["aiohttp>=3.9,<4"],
        # Evaluation on a Dask scheduler.
        "cluster": ["distributed>=2024.1"],
        # SQLite bags of rosbag2, and those of ROS 1.
        "rosbags": ["rosbags>=0.11,<1"],
        # Video packets in bags, video files of more than 8 bits, films in H.264.
        "video": ["av>=12,<19"],
        # Tables of objects in Parquet.
        "parquet": ["pyarrow>=14"],
        "test": [
            "pytest>=7.4,<10",
            "pytest-timeout>=2,<3",
            "pytest-xdist>=3,<4",
            "hypothesis>=6,<7",
            "rosbags>=0.11,<1",
            "av>=12,<19",
            "pyarrow>=14",
        ],
        # The reference of the library.
        "docs": ["sphinx>=7,<10"],
        "lint": ["ruff", "mypy", "types-PyYAML", "types-tqdm", "scipy-stubs"],
        "fuzz": ["atheris>=2.3,<4"],
        "colcon": ["colcon-common-extensions>=0.3,<1"],
    },
    # Type checkers look for py.typed in a folder.
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"turbseg_{name} = {PACKAGE}.cli.__main__:{'import_' if name == 'import' else name}"
            for name in EXECUTABLES
        ],
    },
)
