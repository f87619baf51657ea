// SPDX-License-Identifier: GPL-3.0-or-later
//
// Content encodings: gzip (RFC 1952) and zstd (RFC 8878) as streams, for bodies that come and answers that go, and what
// the headers about them say.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "api/http/http.h"

namespace spherule::server {

enum class Encoding { identity, gzip, zstd };

/// As headers write it.
std::string_view name(Encoding encoding);

/// A Content-Encoding header, empty for none. Throws unknown_format for what is not known here, and for lists.
Encoding content_encoding(std::string_view header);

/// The best of the three for an Accept-Encoding header (RFC 9110, 12.5.3): by its q-values; among equals zstd before
/// gzip before none. An empty header asks for none.
Encoding preferred_encoding(std::string_view accept_encoding);

class Unpacker {
 public:
  virtual ~Unpacker() = default;
  /// Hands on what the next bytes unpack to, in small pieces. Members and frames may follow one another. Throws
  /// malformed when they are not what was announced.
  virtual void feed(std::string_view bytes, const api::Body::Take& take) = 0;
  /// Whether the last member is complete.
  virtual bool ended() const = 0;
};

class Packer {
 public:
  virtual ~Packer() = default;
  /// What the next bytes pack to so far; with `last`, to the end.
  virtual std::string feed(std::string_view bytes, bool last) = 0;
};

/// For gzip and zstd. Throws bad_alloc.
std::unique_ptr<Unpacker> make_unpacker(Encoding encoding);
std::unique_ptr<Packer> make_packer(Encoding encoding);

/// Whether content of this type shrinks: text does, pictures and packed samples do not.
bool compressible(std::string_view media_type);

/// Entity tags differ between encodings: the tag of the packed form, and the plain forms of all tags in a header.
std::string packed_tag(std::string plain, Encoding encoding);
std::string plain_tags(std::string tags);

}  // namespace spherule::server
