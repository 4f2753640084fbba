"""Build of the turbseg_ros package, by pip and by colcon alike."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "turbseg_ros"

EXECUTABLES = ("node", "play", "replay", "evaluate", "simulate", "train", "import", "benchmark")


def _files(folder: str) -> list[str]:
    return sorted(str(path) for path in Path(folder).iterdir() if path.is_file())


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Live segmentation of moving objects seen through atmospheric turbulence.",
    author="turbseg_ros maintainers",
    maintainer="turbseg_ros maintainers",
    maintainer_email="maintainers@turbseg-ros.invalid",
    license="Apache-2.0",
    # Said aloud, so that an editable installation is a plain path, which type checkers follow too.
    package_dir={"": "."},
    packages=find_packages(include=[f"{PACKAGE}*"]),
    package_data={PACKAGE: ["py.typed", "evaluation/*.jinja", "learning/weights/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", _files("config")),
        (f"share/{PACKAGE}/launch", _files("launch")),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools", "numpy", "scipy", "PyYAML", "tqdm"],
    extras_require={
        # What a machine without ROS 2 takes from the package registry; a ROS machine has these
        # from its own distribution (package.xml), under other package names.
        "wheels": [
            "ros-jazzy-rclpy",
            "ros-jazzy-common-interfaces",
            "ros-jazzy-rmw-fastrtps-cpp",
            "ros-wheels-bootstrapper",
            "opencv-python-headless",
        ],
        # RAFT, and training; the pretrained network runs by OpenCV.
        "learning": ["torch", "torchvision", "safetensors", "onnx", "onnxscript"],
        "bags": ["mcap", "distributed", "jinja2"],
        "test": ["pytest", "pytest-timeout", "hypothesis", "rosbags"],
        "lint": ["ruff", "mypy", "types-PyYAML", "types-tqdm", "scipy-stubs"],
        "colcon": ["colcon-common-extensions"],
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
