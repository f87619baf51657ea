// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/image.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>

#include "core/base/check.h"

namespace spherule {
namespace {

bool whole(const Image& image) {
  return image.width > 0 && image.height > 0 &&
         image.rgba.size() == 4 * static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
}

// Memory never refuses a write, and both writers take 8-bit RGBA: failing in here is our own defect. The library's
// words are for the log.
void require(bool done, const char* format, const OIIO::ImageOutput* output) {
  if (done) return;
  throw Defect(std::string("no ") + format + " was written: " + (output ? output->geterror() : OIIO::geterror()));
}

// Writes a frame in pieces of some ms.
bool write(const Image& frame, const Context& context, OIIO::ImageOutput& output) {
  const int rows = std::max(1, (1 << 17) / frame.width);
  for (int y = 0; y < frame.height; y += rows) {
    context.throw_if_cancelled();
    const int end = std::min(frame.height, y + rows);
    if (!output.write_scanlines(y, end, 0, OIIO::TypeDesc::UINT8, frame.at(0, y))) return false;
  }
  return true;
}

std::string encode(const char* format, std::span<const Image> frames, OIIO::ImageSpec spec, const Context& context) {
  spec.attribute("oiio:ColorSpace", "sRGB");
  spec.attribute("oiio:UnassociatedAlpha", 1);
  std::vector<unsigned char> bytes;
  OIIO::Filesystem::IOVecOutput memory(bytes);
  const auto output = OIIO::ImageOutput::create(format);
  require(output && output->set_ioproxy(&memory), format, output.get());
  const std::string name = std::string("memory.") + format;
  const std::vector<OIIO::ImageSpec> specs(frames.size(), spec);
  require(
      frames.size() == 1 ? output->open(name, spec) : output->open(name, static_cast<int>(specs.size()), specs.data()),
      format, output.get());
  for (std::size_t i = 0; i < frames.size(); ++i) {
    require(i == 0 || output->open(name, spec, OIIO::ImageOutput::AppendSubimage), format, output.get());
    require(write(frames[i], context, *output), format, output.get());
  }
  require(output->close(), format, output.get());
  return {bytes.begin(), bytes.end()};
}

}  // namespace

Image blank_image(int width, int height) {
  SPHERULE_CHECK(width > 0 && height > 0);
  return {width, height,
          std::vector<std::uint8_t>(4 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height))};
}

void place(const Image& part, int x, int y, Image& whole) {
  const int left = std::max(0, -x), right = std::min(part.width, whole.width - x);
  if (left >= right) return;
  for (int row = std::max(0, -y); row < std::min(part.height, whole.height - y); ++row)
    std::copy_n(part.at(left, row), 4 * static_cast<std::size_t>(right - left), whole.at(x + left, y + row));
}

std::string encode_png(const Image& image, const Context& context) {
  SPHERULE_CHECK(whole(image));
  return encode("png", std::span(&image, 1), {image.width, image.height, 4, OIIO::TypeDesc::UINT8}, context);
}

std::string encode_gif(std::span<const Image> frames, int frames_per_second, const Context& context) {
  SPHERULE_CHECK(!frames.empty() && std::ranges::all_of(frames, whole));
  OIIO::ImageSpec spec(frames.front().width, frames.front().height, 4, OIIO::TypeDesc::UINT8);
  for (const Image& frame : frames) SPHERULE_CHECK(frame.width == spec.width && frame.height == spec.height);
  spec.attribute("oiio:Movie", 1);
  const std::array<int, 2> rate{frames_per_second, 1};
  spec.attribute("FramesPerSecond", OIIO::TypeRational, rate.data());
  return encode("gif", frames, std::move(spec), context);
}

}  // namespace spherule
