#!/usr/bin/env python3
"""Reads recordings with the reference implementations (packages mcap and mcap-protobuf-support) and counts.

    pip install mcap mcap-protobuf-support
    python3 read_mcap.py RUN/recordings/*.mcap

Prints for each file its identity and the messages of each topic, and over all files the frames: steps that differ in
(kitchen, environment, exchange). Nothing of this repository is needed to decode them: files carry their schemas.
"""
import collections
import struct
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def main(paths):
    frames = set()
    steps = 0
    for path in paths:
        counts = collections.Counter()
        with open(path, "rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for metadata in reader.iter_metadata():
                print(f"{path}: {metadata.name} {dict(sorted(metadata.metadata.items()))}")
            attachments = {attachment.name: len(attachment.data) for attachment in reader.iter_attachments()}
            print(f"{path}: attachments {attachments}")
            for schema, channel, _, message in reader.iter_decoded_messages():
                counts[channel.topic, schema.name] += 1
                if channel.topic == "/step":
                    frames.add((message.kitchen, message.environment, message.exchange))
                elif schema.name == "foxglove.RawImage":
                    check_image(message)
        steps += counts["/step", "stillroom.Step"]
        for (topic, schema), count in sorted(counts.items()):
            print(f"{path}: {topic} {schema} {count}")
    print(f"steps: {steps}")
    print(f"frames: {len(frames)}")


def check_image(image):
    assert image.encoding == "16UC1" and image.step == 2 * image.width, image.encoding
    pixels = struct.unpack(f"<{image.width * image.height}H", image.data)
    assert max(pixels) < 32767, "deeper than the format allows"


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(sys.argv[1:])
