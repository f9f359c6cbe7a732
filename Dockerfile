# CPU: everything but training on a GPU. docker build -t ccdiff-env . && docker run --rm ccdiff-env doctor
FROM rust:1-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3-pip python3-venv git g++
WORKDIR /src
COPY . .
RUN python3 -m venv /opt/build && /opt/build/bin/pip install -q 'maturin>=1.9.4,<2' \
 && CCDIFF_MODELS=0 /opt/build/bin/pip wheel -q --no-deps --no-build-isolation -w /dist .

FROM python:3.11-slim-bookworm
COPY --from=build /dist /dist
RUN pip install -q --no-cache-dir /dist/*.whl matplotlib pillow tqdm && rm -r /dist
ENTRYPOINT ["ccdiff-env"]
CMD ["doctor"]
