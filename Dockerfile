# docker build -t rfpp .
# docker run --rm -v "$PWD:/work" rfpp render scene=chair.glb   # a file of yours
# docker run --rm --gpus all --ipc=host -v "$PWD:/work" rfpp train experiment=quickstart
# For a CPU alone, which is smaller: --build-arg PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu
# Tested with buildah for the CPU, on Debian with Python 3.11 in /usr/local, as in the image below, and on Debian without Python.
# Untested: the image below itself, a base of CUDA, --gpus.
# Another base, of Debian or Ubuntu with Python 3.11: --build-arg BASE=nvidia/cuda:12.8.1-runtime-ubuntu22.04
ARG BASE=python:3.11-slim-bookworm
FROM ${BASE}

# The libraries that Blender's Python module needs and no wheel carries.
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 \
        $(command -v python3.11 >/dev/null || echo python3.11 python3.11-venv) \
    && rm -rf /var/lib/apt/lists/*

RUN python3.11 -m venv /opt/venv
ENV PATH=/opt/venv/bin:$PATH

ARG PIP_EXTRA_INDEX_URL
COPY . /opt/rfpp
RUN pip install --no-cache-dir -c /opt/rfpp/requirements.lock '/opt/rfpp[all]'
# The VGG16 weights of LPIPS, for training and evaluation.
RUN rfpp weights
# Compiles the loops over rays, which every new container would do otherwise. Another processor compiles them anew.
RUN rfpp render scene=/opt/rfpp/data/scenes/cornell_box.json cameras=0 resolution=16 output=/tmp/compiled \
    && rm -r /tmp/compiled

# Runs, shards and renders go below the folder that it is started in: mount one of yours here.
WORKDIR /work
ENTRYPOINT ["rfpp"]
CMD ["--help"]
