# The CPU image: one worker, driver or scheduler. Build from the repository's root:
#   docker build -f docker/cpu.Dockerfile -t yesnt .
FROM python:3.11-slim-bookworm
WORKDIR /opt/yesnt
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY yesnt yesnt
COPY workflows workflows
RUN pip install --no-cache-dir -c constraints.txt .
RUN useradd --create-home artist
USER artist
ENTRYPOINT ["yesnt"]
