# The CPU image: driver, scheduler or worker. Build from the repository's root:
#   docker build -f docker/cpu.Dockerfile -t yesnt:0.1.0 .
FROM python:3.11-slim-bookworm
WORKDIR /opt/yesnt
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY yesnt yesnt
COPY workflows workflows
RUN python3 -m venv /opt/venv && /opt/venv/bin/pip install --no-cache-dir -c constraints.txt '.[slurm,kubernetes]'
ENV PATH=/opt/venv/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
# A shared folder belongs to users that the image does not know; everything that is written goes there or to /tmp.
RUN useradd --create-home artist
USER artist
WORKDIR /tmp
ENTRYPOINT ["yesnt"]
