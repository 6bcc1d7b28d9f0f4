# One image that benches and serves, with off-screen rendering on the CPU (docs/install.md, "In a container"):
#   docker build -t cognitivedrone .
#   docker run --rm -v "$PWD/results:/flights/results" cognitivedrone bench --suite open-v1:smoke
ARG BASE=debian:trixie-slim

FROM ${BASE} AS build
ARG EXTRAS=serve,vlm
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv
COPY . /source
RUN python3 -m venv /opt/cognitivedrone \
  && /opt/cognitivedrone/bin/pip install --no-cache-dir "/source${EXTRAS:+[$EXTRAS]}" \
  && /opt/cognitivedrone/bin/pip uninstall --yes pip

FROM ${BASE}
RUN apt-get update \
  && apt-get install -y --no-install-recommends python3 libegl1 libgl1-mesa-dri libopengl0 \
  && rm -rf /var/lib/apt/lists/* \
  && useradd --uid 1000 --create-home drone \
  && install -d -o drone -g drone /flights /flights/results
COPY --from=build /opt/cognitivedrone /opt/cognitivedrone
ENV PATH=/opt/cognitivedrone/bin:$PATH
USER drone
WORKDIR /flights
ENTRYPOINT ["cognitivedrone"]
CMD ["--help"]
