# The CUDA image: the same code with a CUDA build of torch. Not tested on hardware yet (README, "What it does not do").
#   docker build -f docker/gpu.Dockerfile -t yesnt:gpu .
FROM nvidia/cuda:12.8.1-runtime-ubuntu24.04
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/yesnt
COPY pyproject.toml README.md LICENSE ./
COPY yesnt yesnt
COPY workflows workflows
RUN python3 -m venv /opt/venv && /opt/venv/bin/pip install --no-cache-dir .
RUN useradd --create-home artist
USER artist
ENTRYPOINT ["/opt/venv/bin/yesnt"]
