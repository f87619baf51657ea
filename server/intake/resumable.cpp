// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/intake/resumable.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>
#include <sstream>
#include <vector>

#include "core/base/error.h"
#include "server/base/digest.h"
#include "server/base/disk.h"

namespace spherule::server {

namespace {

namespace fs = std::filesystem;
using std::chrono::system_clock;

[[noreturn]] void throw_missing() {
  throw Error(ErrorCode::not_found, "There is no such upload; it was finished, deleted, expired or never begun.");
}
[[noreturn]] void throw_full() {
  throw Error(ErrorCode::no_space,
              "The server's storage is full; what has come of this upload is kept for now, so go on later.");
}

// Ids come from clients: only what we make ourselves names a file.
bool is_id(const std::string& id) {
  return id.starts_with("upl_") && id.size() > 4 && id.find_first_not_of("0123456789abcdef", 4) == std::string::npos;
}

struct About {
  std::uint64_t length = 0;
  std::string filename;
  api::Time begun;
};

std::optional<About> about_in(const std::string& text) {
  std::istringstream in(text);
  About about;
  std::int64_t begun = 0;
  if (!(in >> about.length) || !in.ignore(1) || !std::getline(in, about.filename) || !(in >> begun) || in.get() != '\n')
    return {};
  // Counted in nanoseconds it must fit 64 bits.
  constexpr std::int64_t latest = std::numeric_limits<std::int64_t>::max() / 1'000'000;
  if (begun < 0 || begun > latest) return {};
  about.begun = api::Time(std::chrono::milliseconds(begun));
  return about;
}

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
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

bool is_sound_upload(std::string_view info) { return about_in(std::string(info)).has_value(); }

ResumableUploads::ResumableUploads(fs::path folder, std::uint64_t limit, std::chrono::seconds keep, std::size_t most,
                                   Surroundings around)
    : folder_(std::move(folder)), limit_(limit), keep_(keep), most_(most), around_(std::move(around)) {
  make_folder(folder_);
  sweep();
}

fs::path ResumableUploads::part(const std::string& id) const { return folder_ / (id + ".part"); }
fs::path ResumableUploads::info(const std::string& id) const { return folder_ / (id + ".info"); }

std::vector<std::string> ResumableUploads::ids() const {
  std::set<std::string> ids;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder_, ignored))
    if (const std::string id = entry.path().stem(); is_id(id)) ids.insert(id);
  return {ids.begin(), ids.end()};
}

// What was announced and has not come yet.
std::uint64_t ResumableUploads::missing_bytes() const {
  std::uint64_t sum = 0;
  for (const std::string& id : ids()) try {
      const api::UploadInfo upload = find(id);
      sum += upload.length - upload.offset;  // at most most_ times limit_
    } catch (const Error&) {
      // Gone, or never to be finished.
    }
  return sum;
}

void ResumableUploads::check_room(std::uint64_t bytes) const {
  const std::uint64_t room = around_.free_bytes(), promised = missing_bytes();
  if (promised > room || bytes > room - promised) {
    throw Error(ErrorCode::no_space,
                "The upload does not fit on the server's disk beside those that are under way; try again later, or "
                "send less.");
  }
}

api::UploadInfo ResumableUploads::create(std::uint64_t length, std::string_view filename) {
  if (length > limit_) {
    throw Error(ErrorCode::too_large,
                "The upload is larger than the " + std::to_string(limit_) + " bytes that this server accepts.");
  }
  sweep();
  const std::lock_guard lock(creating_);
  if (ids().size() >= most_) {
    throw Error(ErrorCode::busy, "Too many uploads are unfinished; finish or delete some, or try again later.");
  }
  check_room(length);
  const std::string id = random_id("upl");
  const Busy busy(*this, id);
  const auto begun = std::chrono::duration_cast<std::chrono::milliseconds>(system_clock::now().time_since_epoch());
  File(part(id), O_WRONLY | O_CREAT | O_EXCL).set_time(around_.served());  // its name goes with that of the other
  write_durably(info(id), std::to_string(length) + "\n" + plain(filename) + "\n" + std::to_string(begun.count()) + "\n",
                around_.served());
  return find(id);
}

api::UploadInfo ResumableUploads::find(const std::string& id) const {
  struct stat status {};
  if (!is_id(id) || ::stat(part(id).c_str(), &status) != 0 || !fs::exists(info(id))) throw_missing();
  const std::optional<About> about = about_in(text_of(info(id)));
  const auto size = static_cast<std::uint64_t>(status.st_size);
  if (!about || size > about->length) {
    throw Error(ErrorCode::corrupt,
                "The server's record of this upload is damaged; delete the upload and begin it anew.");
  }
  // A power cut may leave an empty part with any time.
  const Time grew = std::max(file_time(part(id)).value_or(Time()), file_time(info(id)).value_or(Time()));
  const auto left = grew + keep_ - around_.served();
  if (left < left.zero()) throw_missing();
  return {.id = id,
          .filename = about->filename,
          .length = about->length,
          .offset = size,
          .created = about->begun,
          .expires = now() + left};
}

api::UploadInfo ResumableUploads::append(const std::string& id, std::uint64_t offset,
                                         const std::function<void(const TakeBytes&)>& feed) {
  find(id);
  const Busy busy(*this, id);
  const api::UploadInfo upload = find(id);
  if (offset != upload.offset) {
    throw Error(ErrorCode::conflict, "The upload stands at " + std::to_string(upload.offset) +
                                         " bytes; go on from there (HEAD tells the offset).");
  }
  const File data(part(id), O_WRONLY | O_APPEND);
  const auto keep = [&] {
    data.set_time(around_.served());
    data.sync();
  };
  std::uint64_t left = upload.length - offset;
  try {
    feed([&](std::string_view piece) {
      if (piece.size() > left) {
        throw Error(ErrorCode::too_large, "These are more bytes than the upload was announced to have.");
      }
      // Others write, too: what was free at the beginning need not be.
      if (around_.free_bytes() < piece.size()) throw_full();
      data.write(piece);
      left -= piece.size();
    });
  } catch (...) {
    // What has arrived stays, and the offset that is told next is durable; the sender is told what broke.
    try {
      keep();
    } catch (const Error&) {
    }
    throw;
  }
  keep();
  return find(id);
}

void ResumableUploads::read(const std::string& id, const TakeBytes& take) const {
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
  try {
    find(id);
  } catch (const Error& error) {
    if (error.code() != ErrorCode::corrupt) throw;
  }
  const Busy busy(*this, id);
  std::error_code ignored;  // the next sweep tries again
  fs::remove(part(id), ignored);
  fs::remove(info(id), ignored);
}

// All under the mutex: what is busy stays so while it is looked at.
void ResumableUploads::sweep() {
  const std::lock_guard lock(mutex_);
  for (const std::string& id : ids()) {
    if (busy_.contains(id)) continue;
    try {
      find(id);
    } catch (const Error& error) {
      const bool damaged = error.code() == ErrorCode::corrupt;
      std::error_code ignored;
      for (const fs::path& file : {part(id), info(id), folder_ / (id + ".new")}) {
        if (!damaged) fs::remove(file, ignored);
        if (damaged && around_.set_aside) around_.set_aside(file);
      }
    }
  }
}

}  // namespace spherule::server
