// SPDX-License-Identifier: GPL-3.0-or-later
//
// Content encodings, as streams: gzip for bodies that come and answers that go, and what the headers about them say.
#pragma once

#include <zlib.h>

#include <string>
#include <string_view>

#include "api/http.h"

namespace spherule::server {

/// Unpacks gzip; members may follow one another.
class Inflater {
 public:
  Inflater();
  ~Inflater();
  Inflater(const Inflater&) = delete;
  Inflater& operator=(const Inflater&) = delete;

  /// Hands on what the next bytes unpack to. Throws malformed when they are not gzip.
  void feed(std::string_view bytes, const api::Body::Take& take);
  /// Whether the last member is complete.
  bool ended() const { return ended_; }

 private:
  z_stream stream_{};
  bool ended_ = false;
};

/// Packs into gzip.
class Deflater {
 public:
  Deflater();
  ~Deflater();
  Deflater(const Deflater&) = delete;
  Deflater& operator=(const Deflater&) = delete;

  /// What the next bytes pack to so far; with `last`, to the end.
  std::string feed(std::string_view bytes, bool last);

 private:
  z_stream stream_{};
};

/// Whether content of this type shrinks.
bool compressible(std::string_view media_type);

/// Whether an Accept-Encoding header allows gzip.
bool accepts_gzip(std::string_view accept_encoding);

/// Entity tags differ between encodings: the tag of the packed form, and the plain forms of the tags in a header.
std::string packed_tag(std::string plain);
std::string plain_tags(std::string tags);

}  // namespace spherule::server
