// SPDX-License-Identifier: GPL-3.0-or-later
//
// Bytes on their way into the store: received piece by piece, counted and hashed as they come, readable before anyone
// decides to keep them, and gone without a trace unless committed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "server/base/digest.h"

namespace spherule::server {

/// One open, immutable run of bytes in the store. It stays readable while the object lives, even when the blob is
/// removed meanwhile; only path() needs the blob to be there still. Movable. Reading is thread safe.
class Blob {
 public:
  /// Takes the descriptor over. `sha256` is the digest that was recorded when the bytes were written.
  Blob(int descriptor, std::filesystem::path path, std::string sha256);
  ~Blob();
  Blob(Blob&& other) noexcept;
  Blob& operator=(Blob&& other) noexcept;

  [[nodiscard]] std::uint64_t size() const { return size_; }
  [[nodiscard]] const std::string& sha256() const { return sha256_; }

  /// A file that holds exactly these bytes, for readers that want one. It has no useful name: see ScratchFolder.
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

  /// For system calls that take one; the blob closes it.
  [[nodiscard]] int descriptor() const { return descriptor_; }

  /// Fills `out` from `offset` on and returns how many bytes there were: fewer than asked only at the end.
  /// Throws corrupt when the disk cannot give them back.
  std::size_t read_at(std::uint64_t offset, std::span<char> out) const;

  /// All bytes, verified against the recorded digest. Throws corrupt when they differ.
  [[nodiscard]] std::string read() const;

  /// As read(), without keeping the bytes; O(size) time, O(1) memory. Throws cancelled.
  void verify(const Context& context = {}) const;

 private:
  int descriptor_;
  std::filesystem::path path_;
  std::string sha256_;
  std::uint64_t size_;
};

/// An upload or a result that is being written. Destroyed without commit(), nothing remains. Made by BlobStore::stage.
/// One thread at a time.
class Staging {
 public:
  virtual ~Staging() = default;
  Staging(const Staging&) = delete;
  Staging& operator=(const Staging&) = delete;

  /// Throws too_large when the total would pass the limit that stage() was given, no_space when storage is full.
  /// After a throw the staging is only good for being destroyed.
  void append(std::string_view bytes);

  [[nodiscard]] std::uint64_t size() const { return size_; }
  [[nodiscard]] std::string sha256() const { return digest_.hex(); }

  /// Nothing is appended for now: gives back what appending needs, a descriptor above all.
  virtual void rest() {}

  /// The bytes so far, for sniffing and parsing before commit().
  [[nodiscard]] virtual Blob open() const = 0;

  /// Makes the bytes durable (they survive a power cut once this returns) and returns the key to open them by.
  /// Every commit makes a new key, never used before: `name`, the digest and a random part, so two uploads of the same
  /// bytes cannot disturb each other. `name` is one or two parts of [a-z0-9_-]+ with a slash between, such as
  /// "volumes/vol_1f…-0"; never text that a client chose. At most once. Throws no_space.
  [[nodiscard]] virtual std::string commit(std::string_view name) = 0;

 protected:
  explicit Staging(std::uint64_t limit) : limit_(limit) {}
  virtual void write(std::string_view bytes) = 0;

 private:
  std::uint64_t limit_;
  std::uint64_t size_ = 0;
  Sha256 digest_;
};

/// A folder of links, for readers that go by file names (a header that names its data file). Removed with its links
/// by the destructor, or by the next start after a crash, since names may tell about a patient.
class ScratchFolder {
 public:
  /// `parent` is BlobStore::scratch_root().
  explicit ScratchFolder(const std::filesystem::path& parent);
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  /// Gives the blob a name in this folder and returns the full path, where its bytes stay, whatever becomes of the
  /// blob, as long as this lives. `name` may come from a client: anything but a plain file name of at most 255 bytes,
  /// used once, is refused with invalid_argument. Takes no descriptor where the file system can give a file two names.
  std::filesystem::path link(Blob blob, const std::string& name);

 private:
  std::filesystem::path folder_;
  std::vector<Blob> open_;  // that have a second name only while they are
};

}  // namespace spherule::server
