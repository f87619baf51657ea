// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/intake/upload.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <utility>

#include "core/base/error.h"

namespace spherule::server {

namespace {

constexpr std::size_t kMaxFiles = 4096;
// Between two looks at the room, each of which asks for all unfinished uploads; a few dozen senders at once stay within
// the reserve.
constexpr std::uint64_t kLookEvery = std::uint64_t{1} << 20;

}  // namespace

FileUpload::FileUpload(BlobStore& blobs, std::uint64_t limit, std::uint64_t announced, CheckRoom room)
    : blobs_(blobs), limit_(limit), room_(std::move(room)) {
  // Of an unknown length, at least one byte.
  const std::uint64_t bytes = std::max<std::uint64_t>(announced, 1);
  first_ = blobs.stage(limit, bytes);
  room_(bytes);
}

void FileUpload::begin_file(std::string_view name) {
  if (const std::size_t slash = name.find_last_of("/\\"); slash != name.npos) name.remove_prefix(slash + 1);
  if (files_.size() == kMaxFiles) {
    throw Error(ErrorCode::invalid_argument, "Send at most " + std::to_string(kMaxFiles) + " files at once.");
  }
  for (const File& file : files_) {
    if (file.name.empty() || name.empty()) {
      throw Error(ErrorCode::invalid_argument, "Give every one of several files its file name.");
    }
    if (file.name == name) throw Error(ErrorCode::invalid_argument, "Give every file a name of its own.");
  }
  // One descriptor at a time, however many files there are.
  if (!files_.empty()) files_.back().staging->rest();
  files_.push_back({std::string(name), first_ ? std::move(first_) : blobs_.stage(limit_)});
}

void FileUpload::write(std::string_view piece) {
  since_look_ += piece.size();
  if (since_look_ >= kLookEvery) {
    room_(piece.size());
    since_look_ = 0;
  }
  files_.back().staging->append(piece);
}

void FileUpload::unpack(const ArchiveLimits& limits) {
  if (files_.size() != 1) return;
  const Blob bytes = files_.front().staging->open();
  std::array<char, 4> first{};
  if (!is_zip({first.data(), bytes.read_at(0, first)})) return;
  // The archive's own staging goes when its files are there.
  const std::vector<File> archive = std::exchange(files_, {});
  limit_ = limits.unpacked_bytes;
  unpack_zip(
      bytes, limits, [&](std::string_view name) { begin_file(name); }, [&](std::string_view piece) { write(piece); });
}

std::vector<FileUpload::File>& FileUpload::files() {
  if (files_.empty()) throw Error(ErrorCode::invalid_argument, "Send at least one file.");
  std::ranges::sort(files_, {}, &File::name);
  return files_;
}

Mapping::Mapping(const Blob& blob) : size_(blob.size()) {
  const int file = ::open(blob.path().c_str(), O_RDONLY | O_CLOEXEC);
  if (file >= 0 && size_ > 0) data_ = ::mmap(nullptr, size_, PROT_READ, MAP_PRIVATE, file, 0);
  if (file >= 0) ::close(file);
  if (file < 0 || data_ == MAP_FAILED) {
    throw Error(ErrorCode::corrupt, "The stored upload cannot be read back; send it again.");
  }
}

Mapping::~Mapping() {
  if (data_ != nullptr) ::munmap(data_, size_);
}

}  // namespace spherule::server
