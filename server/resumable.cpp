// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/resumable.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <vector>

#include "core/base/error.h"
#include "server/blob_store.h"
#include "server/digest.h"

namespace spherule::server {

namespace {

namespace fs = std::filesystem;
using std::chrono::system_clock;

[[noreturn]] void throw_missing() {
  throw Error(ErrorCode::not_found, "There is no such upload; it was finished, deleted, expired or never begun.");
}
[[noreturn]] void throw_unwritable() {
  throw Error(ErrorCode::no_space, "The server cannot write to its storage; try again later.");
}

class File {
 public:
  File(const fs::path& path, int flags) : descriptor_(::open(path.c_str(), flags | O_CLOEXEC, 0600)) {}
  ~File() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  bool open() const { return descriptor_ >= 0; }
  int descriptor() const { return descriptor_; }

  void write(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t n = ::write(descriptor_, bytes.data(), bytes.size());
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) throw_unwritable();
      bytes.remove_prefix(static_cast<std::size_t>(n));
    }
  }
  void sync() const {
    if (::fdatasync(descriptor_) != 0) throw_unwritable();
  }

 private:
  int descriptor_;
};

// Ids come from clients: only what we make ourselves names a file.
bool is_id(const std::string& id) {
  return id.starts_with("upl_") && id.size() > 4 && id.find_first_not_of("0123456789abcdef", 4) == std::string::npos;
}

std::string plain(std::string_view filename) {
  std::string out(filename.substr(0, 255));
  std::ranges::replace_if(
      out, [](unsigned char c) { return c < 0x20 || c == 0x7f; }, '_');
  return out;
}

}  // namespace

// Marks an upload as being appended to.
class ResumableUploads::Busy {
 public:
  Busy(ResumableUploads& all, const std::string& id) : all_(all), id_(id) {
    const std::lock_guard lock(all.mutex_);
    if (!all.busy_.insert(id).second) {
      throw Error(ErrorCode::conflict, "Another request sends bytes of this upload; wait for its end.");
    }
  }
  ~Busy() {
    const std::lock_guard lock(all_.mutex_);
    all_.busy_.erase(id_);
  }
  Busy(const Busy&) = delete;
  Busy& operator=(const Busy&) = delete;

 private:
  ResumableUploads& all_;
  const std::string& id_;
};

ResumableUploads::ResumableUploads(fs::path folder, std::uint64_t limit, std::chrono::seconds keep, std::size_t most)
    : folder_(std::move(folder)), limit_(limit), keep_(keep), most_(most) {
  make_folder(folder_);
  sweep();
}

fs::path ResumableUploads::part(const std::string& id) const { return folder_ / (id + ".part"); }
fs::path ResumableUploads::info(const std::string& id) const { return folder_ / (id + ".info"); }

api::UploadInfo ResumableUploads::create(std::uint64_t length, std::string_view filename) {
  if (length > limit_) {
    throw Error(ErrorCode::too_large,
                "The upload is larger than the " + std::to_string(limit_) + " bytes that this server accepts.");
  }
  sweep();
  const auto entries = std::distance(fs::directory_iterator(folder_), fs::directory_iterator());
  if (static_cast<std::size_t>(entries) >= 2 * most_) {
    throw Error(ErrorCode::busy, "Too many uploads are unfinished; finish or delete some, or try again later.");
  }
  const std::string id = random_id("upl");
  const auto begun = std::chrono::duration_cast<std::chrono::milliseconds>(system_clock::now().time_since_epoch());
  {
    const File data(part(id), O_WRONLY | O_CREAT | O_EXCL);
    const File about(info(id), O_WRONLY | O_CREAT | O_EXCL);
    if (!data.open() || !about.open()) throw_unwritable();
    about.write(std::to_string(length) + "\n" + plain(filename) + "\n" + std::to_string(begun.count()) + "\n");
    about.sync();
  }
  const File folder(folder_, O_RDONLY | O_DIRECTORY);
  if (::fsync(folder.descriptor()) != 0) throw_unwritable();
  return find(id);
}

api::UploadInfo ResumableUploads::find(const std::string& id) const {
  api::UploadInfo upload;
  struct stat status {};
  std::ifstream about(is_id(id) ? info(id) : fs::path());
  std::int64_t begun = 0;
  if (!is_id(id) || ::stat(part(id).c_str(), &status) != 0 || !(about >> upload.length) || !about.ignore(1) ||
      !std::getline(about, upload.filename) || !(about >> begun)) {
    throw_missing();
  }
  upload.id = id;
  upload.offset = static_cast<std::uint64_t>(status.st_size);
  upload.created = api::Time(std::chrono::milliseconds(begun));
  upload.expires =
      std::chrono::time_point_cast<api::Time::duration>(system_clock::from_time_t(status.st_mtime) + keep_);
  if (upload.expires < system_clock::now()) throw_missing();
  return upload;
}

api::UploadInfo ResumableUploads::append(const std::string& id, std::uint64_t offset,
                                         const std::function<void(const Take&)>& feed) {
  find(id);
  const Busy busy(*this, id);
  const api::UploadInfo upload = find(id);
  if (offset != upload.offset) {
    throw Error(ErrorCode::conflict, "The upload stands at " + std::to_string(upload.offset) +
                                         " bytes; go on from there (HEAD tells the offset).");
  }
  const File data(part(id), O_WRONLY | O_APPEND);
  if (!data.open()) throw_missing();
  // Whatever happens, what has arrived stays, and the offset that is told next is durable.
  struct Sync {
    const File& file;
    ~Sync() { ::fdatasync(file.descriptor()); }
  };
  {
    const Sync sync{data};
    std::uint64_t left = upload.length - offset;
    feed([&](std::string_view piece) {
      if (piece.size() > left) {
        throw Error(ErrorCode::too_large, "These are more bytes than the upload was announced to have.");
      }
      data.write(piece);
      left -= piece.size();
    });
  }
  data.sync();
  return find(id);
}

void ResumableUploads::read(const std::string& id, const Take& take) const {
  const api::UploadInfo upload = find(id);
  if (upload.offset != upload.length) {
    throw Error(ErrorCode::conflict, "The upload lacks " + std::to_string(upload.length - upload.offset) +
                                         " bytes; send them before it is used.");
  }
  const File data(part(id), O_RDONLY);
  std::vector<char> piece(std::size_t{1} << 18);
  for (std::uint64_t left = upload.length; left > 0;) {
    const ssize_t n = ::read(data.descriptor(), piece.data(), piece.size());
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) throw Error(ErrorCode::corrupt, "The upload cannot be read back; delete it and send it again.");
    take({piece.data(), static_cast<std::size_t>(n)});
    left -= std::min(left, static_cast<std::uint64_t>(n));
  }
}

void ResumableUploads::remove(const std::string& id) {
  find(id);
  const Busy busy(*this, id);
  // The data goes first: what is left of an interrupted removal is swept away as expired.
  std::error_code ignored;
  fs::remove(part(id), ignored);
  fs::remove(info(id), ignored);
}

void ResumableUploads::sweep() {
  std::error_code ignored;
  std::vector<std::string> ids;
  for (const auto& entry : fs::directory_iterator(folder_, ignored)) ids.push_back(entry.path().stem());
  for (const std::string& id : ids) {
    try {
      find(id);
    } catch (const Error&) {
      const std::lock_guard lock(mutex_);
      if (busy_.contains(id)) continue;
      fs::remove(part(id), ignored);
      fs::remove(info(id), ignored);
    }
  }
}

}  // namespace spherule::server
