// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/intake/archive.h"

#include <archive.h>
#include <archive_entry.h>
#include <clocale>

#include <algorithm>
#include <memory>
#include <new>
#include <string>
#include <vector>

#include "core/base/error.h"

namespace spherule::server {

namespace {

constexpr std::uint64_t kFree = std::uint64_t{16} << 20;  // bytes that no ratio is asked of

struct Closer {
  void operator()(archive* a) const { archive_read_free(a); }
};
using Reader = std::unique_ptr<archive, Closer>;

[[noreturn]] void throw_damaged() {
  throw Error(ErrorCode::malformed,
              "The zip archive is damaged, encrypted or packed in a way that is not read here; "
              "make it again with plain deflate.");
}

bool leaves_its_folder(std::string_view path) {
  if (path.starts_with('/') || path.starts_with('\\') || (path.size() > 1 && path[1] == ':')) return true;
  for (std::size_t at = 0; at <= path.size();) {
    const std::size_t end = std::min(path.find_first_of("/\\", at), path.size());
    if (path.substr(at, end - at) == "..") return true;
    at = end + 1;
  }
  return false;
}

std::string_view last_part(std::string_view path) { return path.substr(path.find_last_of("/\\") + 1); }

bool is_clutter(std::string_view path) {
  const std::string_view name = last_part(path);
  return path.starts_with("__MACOSX/") || path.find("/__MACOSX/") != path.npos || name.starts_with("._") ||
         name == ".DS_Store" || name == "Thumbs.db";
}

// libarchive converts names by the thread's locale, and gives up in the plain "C" one.
class Utf8Locale {
 public:
  Utf8Locale() : own_(::newlocale(LC_CTYPE_MASK, "C.UTF-8", nullptr)), before_(own_ ? ::uselocale(own_) : nullptr) {}
  ~Utf8Locale() {
    if (own_ == nullptr) return;
    ::uselocale(before_);
    ::freelocale(own_);
  }
  Utf8Locale(const Utf8Locale&) = delete;
  Utf8Locale& operator=(const Utf8Locale&) = delete;

 private:
  locale_t own_, before_;
};

}  // namespace

bool is_zip(std::string_view first) { return first.starts_with("PK\x03\x04") || first.starts_with("PK\x05\x06"); }

void unpack_zip(const Blob& blob, const ArchiveLimits& limits, const std::function<void(std::string_view)>& begin_file,
                const std::function<void(std::string_view)>& take) {
  const Utf8Locale locale;
  const Reader reader(archive_read_new());
  if (!reader) throw std::bad_alloc();
  // The central directory at the end is what counts; a reader that went by the local headers could see other files.
  archive_read_support_format_zip_seekable(reader.get());
  if (archive_read_open_filename(reader.get(), blob.path().c_str(), 1 << 16) != ARCHIVE_OK) throw_damaged();
  std::uint64_t unpacked = 0;
  std::size_t files = 0;
  std::vector<char> piece(std::size_t{1} << 16);
  for (;;) {
    archive_entry* entry = nullptr;
    const int found = archive_read_next_header(reader.get(), &entry);
    if (found == ARCHIVE_EOF) break;
    if (found != ARCHIVE_OK && found != ARCHIVE_WARN) throw_damaged();
    // The second is for names in some other encoding.
    const char* text = archive_entry_pathname_utf8(entry);
    if (text == nullptr) text = archive_entry_pathname(entry);
    if (text == nullptr) throw Error(ErrorCode::invalid_argument, "Name the files of the zip archive in UTF-8.");
    const std::string path = text;
    if (leaves_its_folder(path)) {
      throw Error(ErrorCode::invalid_argument,
                  "The zip archive has a name that leaves its folder; make it again from "
                  "within one folder.");
    }
    if (archive_entry_filetype(entry) == AE_IFDIR || is_clutter(path)) continue;
    if (archive_entry_filetype(entry) != AE_IFREG || archive_entry_hardlink(entry) != nullptr) {
      throw Error(ErrorCode::invalid_argument, "The zip archive has links in it; pack the files themselves.");
    }
    if (archive_entry_is_encrypted(entry) != 0) throw_damaged();
    if (last_part(path).empty()) {
      throw Error(ErrorCode::invalid_argument, "The zip archive has a file without a name; make it again.");
    }
    if (++files > limits.files) {
      throw Error(ErrorCode::too_large,
                  "The zip archive has more than " + std::to_string(limits.files) + " files; send fewer.");
    }
    begin_file(last_part(path));
    for (;;) {
      const la_ssize_t n = archive_read_data(reader.get(), piece.data(), piece.size());
      if (n < 0) throw_damaged();
      if (n == 0) break;
      unpacked += static_cast<std::uint64_t>(n);
      if (unpacked > limits.unpacked_bytes || (unpacked > kFree && unpacked / limits.ratio > blob.size())) {
        throw Error(ErrorCode::too_large,
                    "The zip archive unpacks to more than this server accepts; send less, or the files as they are.");
      }
      take({piece.data(), static_cast<std::size_t>(n)});
    }
  }
  if (files == 0) throw Error(ErrorCode::malformed, "The zip archive has no files.");
}

}  // namespace spherule::server
