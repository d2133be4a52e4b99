# The image of GPU workers: the same versions, with the published backends. Build from the repository's root:
#   docker build -f docker/gpu.Dockerfile -t yesnt:0.1.0-gpu .
# torch's own packages bring the CUDA libraries; the host needs NVIDIA's driver and container toolkit. Its steps are
# tested without a GPU; on one, `docker run --gpus all IMAGE doctor` must name it.
FROM python:3.11-slim-bookworm
WORKDIR /opt/yesnt
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY yesnt yesnt
COPY workflows workflows
RUN python3 -m venv /opt/venv && /opt/venv/bin/pip install --no-cache-dir -c constraints.txt '.[slurm,kubernetes,diffusers]'
ENV PATH=/opt/venv/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
ENV NVIDIA_VISIBLE_DEVICES=all
ENV NVIDIA_DRIVER_CAPABILITIES=compute,utility
RUN useradd --create-home artist
USER artist
WORKDIR /tmp
ENTRYPOINT ["yesnt"]
