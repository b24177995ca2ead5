# docker build -t slbench . && docker run --rm -v "$PWD/out:/data/out" slbench
FROM python:3.11-slim

WORKDIR /src
COPY . .
RUN python -m pip install --no-cache-dir -c constraints.txt . \
    && rm -rf /src
WORKDIR /data

ENTRYPOINT ["slbench"]
CMD ["scan", "step-block", "--out", "out/demo"]
