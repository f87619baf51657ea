// SPDX-License-Identifier: GPL-3.0-or-later
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include "core/base/check.h"
#include "core/render/render.h"

namespace spherule {

std::string encode_png(const Image& image) {
  SPHERULE_CHECK(image.width > 0 && image.height > 0);
  SPHERULE_CHECK(image.rgba.size() ==
                 4 * static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height));
  OIIO::ImageSpec spec(image.width, image.height, 4, OIIO::TypeDesc::UINT8);
  spec.attribute("oiio:ColorSpace", "sRGB");
  spec.attribute("oiio:UnassociatedAlpha", 1);
  std::vector<unsigned char> bytes;
  OIIO::Filesystem::IOVecOutput memory(bytes);
  const auto output = OIIO::ImageOutput::create("png");
  // Memory never refuses a write, and every PNG writer takes 8-bit RGBA: failing here is our own defect.
  SPHERULE_CHECK(output && output->set_ioproxy(&memory));
  SPHERULE_CHECK(output->open("memory.png", spec));
  SPHERULE_CHECK(output->write_image(OIIO::TypeDesc::UINT8, image.rgba.data()));
  SPHERULE_CHECK(output->close());
  return {bytes.begin(), bytes.end()};
}

}  // namespace spherule
