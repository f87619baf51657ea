// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/staging.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>
#include <vector>

#include "core/base/check.h"
#include "core/base/error.h"

namespace spherule::server {

namespace {

[[noreturn]] void throw_corrupt() {
  throw Error(ErrorCode::corrupt, "Stored data is damaged; delete this resource and send its data again.");
}

}  // namespace

Blob::Blob(int descriptor, std::filesystem::path path, std::string sha256)
    : descriptor_(descriptor), path_(std::move(path)), sha256_(std::move(sha256)), size_(0) {
  struct stat status {};
  if (fstat(descriptor_, &status) != 0) {
    ::close(descriptor_);
    throw_corrupt();
  }
  size_ = static_cast<std::uint64_t>(status.st_size);
}

Blob::~Blob() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

Blob::Blob(Blob&& other) noexcept
    : descriptor_(std::exchange(other.descriptor_, -1)),
      path_(std::move(other.path_)),
      sha256_(std::move(other.sha256_)),
      size_(other.size_) {}

Blob& Blob::operator=(Blob&& other) noexcept {
  std::swap(descriptor_, other.descriptor_);
  path_.swap(other.path_);
  sha256_.swap(other.sha256_);
  std::swap(size_, other.size_);
  return *this;
}

// Read rather than mapped: a bad sector is then an Error, not a signal that ends the process.
std::size_t Blob::read_at(std::uint64_t offset, std::span<char> out) const {
  std::size_t done = 0;
  while (done < out.size()) {
    const ssize_t got = ::pread(descriptor_, out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) throw_corrupt();
    if (got == 0) break;
    done += static_cast<std::size_t>(got);
  }
  return done;
}

std::string Blob::read() const {
  // A file that was cut or grew after opening fails here as well: the digest covers every byte and no other.
  std::string bytes(size_, '\0');
  if (read_at(0, bytes) != size_ || sha256_hex(bytes) != sha256_) throw_corrupt();
  return bytes;
}

void Blob::verify(const Context& context) const {
  std::vector<char> piece(std::size_t{1} << 20);
  Sha256 digest;
  for (std::uint64_t offset = 0; const std::size_t got = read_at(offset, piece); offset += got) {
    context.throw_if_cancelled();
    digest.update({piece.data(), got});
  }
  if (digest.hex() != sha256_) throw_corrupt();
}

void Staging::append(std::string_view bytes) {
  // Not size_ + bytes.size() > limit_, which could wrap.
  if (bytes.size() > limit_ - size_)
    throw Error(ErrorCode::too_large, "The data is larger than the " + std::to_string(limit_) +
                                          " bytes that this server accepts; send less, or raise its limit.");
  write(bytes);
  digest_.update(bytes);
  size_ += bytes.size();
}

ScratchFolder::ScratchFolder(const std::filesystem::path& parent) : folder_(parent / random_id("scratch")) {
  std::error_code failed;
  std::filesystem::create_directory(folder_, failed);
  if (failed) throw Error(ErrorCode::no_space, "The server cannot write to its storage; try again later.");
}

ScratchFolder::~ScratchFolder() {
  std::error_code ignored;  // the next start tries again
  std::filesystem::remove_all(folder_, ignored);
}

std::filesystem::path ScratchFolder::link(Blob blob, const std::string& name) {
  const auto refuse = [](const char* sentence) { throw Error(ErrorCode::invalid_argument, sentence); };
  if (name.empty() || name.size() > 255 || name == "." || name == ".." || name.find('/') != std::string::npos ||
      name.find('\0') != std::string::npos)
    refuse("A part's file name must be a plain name of at most 255 bytes, without folders.");
  const std::filesystem::path place = folder_ / name;
  std::error_code failed;
  std::filesystem::create_hard_link(blob.path(), place, failed);
  if (failed && failed != std::errc::file_exists) {
    // A link by absolute path works wherever the reader stands, and into other file systems.
    std::filesystem::create_symlink(std::filesystem::absolute(blob.path()), place, failed);
    open_.push_back(std::move(blob));
  }
  if (failed == std::errc::file_exists) refuse("Two parts have the same file name; give each part its own.");
  if (failed) throw Error(ErrorCode::no_space, "The server cannot write to its storage; try again later.");
  return place;
}

}  // namespace spherule::server
