// SPDX-License-Identifier: GPL-3.0-or-later
//
// Pictures as plain pixels, and their files. image.cpp is the only user of OpenImageIO.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/base/context.h"

namespace spherule {

/// 8-bit sRGB with alpha (not premultiplied), row-major from the top left, 4 bytes a pixel.
struct Image {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;

  std::uint8_t* at(int x, int y) { return &rgba[offset(x, y)]; }
  const std::uint8_t* at(int x, int y) const { return &rgba[offset(x, y)]; }

 private:
  std::size_t offset(int x, int y) const {
    return 4 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x));
  }
};

/// A transparent picture. Both sizes above 0.
Image blank_image(int width, int height);

/// Copies `part` into `whole` with its top left corner at (x, y); what lies beyond the edges is left out.
void place(const Image& part, int x, int y, Image& whole);

/// PNG bytes: 8 bits a channel, sRGB, no metadata that changes from run to run, the same for the same pixels. Throws
/// cancelled, within tens of ms.
std::string encode_png(const Image& image, const Context& context = {});

/// An endless animation as GIF bytes: up to 256 colours a frame; alpha below a half is transparent. The frames are of
/// one size; at least one. Throws cancelled, between frames: the library that makes one of them cannot be interrupted.
std::string encode_gif(std::span<const Image> frames, int frames_per_second, const Context& context = {});

}  // namespace spherule
