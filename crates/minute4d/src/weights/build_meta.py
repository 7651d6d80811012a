# Stands for setuptools while pip downloads a source distribution: pip wants its metadata, and setuptools would run the package's own
# build script for it.
import os
import sys

NAME, VERSION = "{name}", "{version}"


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    folder = f"{NAME}-{VERSION}.dist-info"
    os.makedirs(os.path.join(metadata_directory, folder))
    with open(os.path.join(metadata_directory, folder, "METADATA"), "w") as file:
        file.write(f"Metadata-Version: 2.1\nName: {NAME}\nVersion: {VERSION}\n")
    return folder


__legacy__ = sys.modules[__name__]
