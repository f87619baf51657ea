// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/openvdb_tree.h"

#include <openvdb/io/Compression.h>
#include <openvdb/util/NodeMasks.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <set>
#include <sstream>

namespace spherule::vdb {

namespace {

using Index = std::array<std::int64_t, 3>;

// Nodes hold 2^log of their children along an axis; total is log of the voxels.
template <int Level>
struct Node;
template <>
struct Node<0> {
  static constexpr int log = 3, total = 3;
};
template <>
struct Node<1> {
  static constexpr int log = 4, total = 7;
};
template <>
struct Node<2> {
  static constexpr int log = 5, total = 12;
};
template <int Level>
using MaskOf = openvdb::util::NodeMask<Node<Level>::log>;

// The place of entry n of a node: z is fastest.
template <int Level>
Index place_of(const Index& origin, std::uint32_t n) {
  constexpr int log = Node<Level>::log, child = Node<Level>::total - log;
  constexpr std::uint32_t ones = (1U << log) - 1;
  return {origin[0] + (std::int64_t{n >> 2 * log} << child), origin[1] + (std::int64_t{n >> log & ones} << child),
          origin[2] + (std::int64_t{n & ones} << child)};
}

// A node's values in front of the stream: what stands for the inactive ones, and how many bytes the others take.
template <int Level>
struct Values {
  char form = 0;
  std::array<std::array<char, 24>, 2> inactive{};
  MaskOf<Level> selection;
  std::size_t count = 0;    // of values in the file
  std::uint64_t bytes = 0;  // that they take there
  bool packed = false;
};

class TreeStream {
 public:
  TreeStream(Stream& stream, const TreePlace& place) : stream_(stream), place_(place) {}

  Stream& stream() { return stream_; }
  const GridType& type() const { return *place_.type; }
  bool halved() const { return place_.half && type().halved != type().bytes; }
  std::uint32_t compression() const { return place_.compression; }

  template <int Level>
  MaskOf<Level> mask() {
    MaskOf<Level> mask;
    mask.load(stream_.in());
    return mask;
  }

  // Leaves the stream at the values themselves. OpenVDB reads as many packed bytes as a length in the file says,
  // whatever the room for what they become; here lengths are bounded first.
  template <int Level>
  Values<Level> values(const MaskOf<Level>& active) {
    using namespace openvdb::io;
    Values<Level> v;
    v.form = stream_.value<char>();
    const bool two = v.form == MASK_AND_TWO_INACTIVE_VALS;
    const bool one = v.form == NO_MASK_AND_ONE_INACTIVE_VAL || v.form == MASK_AND_ONE_INACTIVE_VAL;
    for (int i = 0; i < (two ? 2 : one ? 1 : 0); ++i) {
      stream_.in().read(v.inactive[static_cast<std::size_t>(i)].data(), static_cast<std::streamsize>(type().bytes));
    }
    if (two || v.form == MASK_AND_NO_INACTIVE_VALS || v.form == MASK_AND_ONE_INACTIVE_VAL) {
      v.selection.load(stream_.in());
    }
    const bool only_active = (compression() & COMPRESS_ACTIVE_MASK) != 0 && v.form != NO_MASK_AND_ALL_VALS;
    v.count = only_active ? active.countOn() : MaskOf<Level>::SIZE;
    v.bytes = v.count * (halved() ? type().halved : type().bytes);
    if (halved() && v.count == 0) return v;
    if ((compression() & (COMPRESS_BLOSC | COMPRESS_ZIP)) == 0) return v;
    const auto length = stream_.value<std::int64_t>();  // negated where the values were not worth packing
    if (length <= 0) {
      if (length != -static_cast<std::int64_t>(v.bytes)) fail_damaged();
      return v;
    }
    stream_.need(static_cast<std::uint64_t>(length));
    v.packed = true;
    v.bytes = static_cast<std::uint64_t>(length);
    return v;
  }

  // The values as they are unpacked, `count` of them.
  template <typename T, int Level>
  void unpack(const Values<Level>& v, std::vector<T>& into) {
    into.resize(v.count);
    if (v.count == 0) {
      stream_.skip(v.bytes);
      return;
    }
    if (halved()) {
      std::vector<openvdb::math::half> halves(v.count);
      unpack_bytes(v, reinterpret_cast<char*>(halves.data()), halves.size() * sizeof(openvdb::math::half));
      if constexpr (std::is_floating_point_v<T>) std::ranges::copy(halves, into.begin());
    } else {
      unpack_bytes(v, reinterpret_cast<char*>(into.data()), into.size() * sizeof(T));
    }
  }

 private:
  template <int Level>
  void unpack_bytes(const Values<Level>& v, char* into, std::size_t size) {
    if (!v.packed) {
      stream_.in().read(into, static_cast<std::streamsize>(size));
      return;
    }
    // OpenVDB reads the length again.
    block_.resize(sizeof(std::int64_t) + v.bytes);
    const auto length = static_cast<std::int64_t>(v.bytes);
    std::memcpy(block_.data(), &length, sizeof length);
    stream_.in().read(block_.data() + sizeof length, length);
    const bool blosc = (compression() & openvdb::io::COMPRESS_BLOSC) != 0;
    if (blosc) check_blosc(std::string_view(block_).substr(sizeof length), size);
    std::istringstream in(block_);
    in.exceptions(std::ios::failbit | std::ios::badbit | std::ios::eofbit);
    if (blosc) {
      openvdb::io::bloscFromStream(in, into, size);
    } else {
      openvdb::io::unzipFromStream(in, into, size);
    }
  }

  // Blosc believes what its own header says about the sizes of the packed bytes and of what they become.
  static void check_blosc(std::string_view packed, std::size_t expected) {
    std::array<std::uint32_t, 4> header;  // versions and flags, unpacked bytes, bytes of a part, packed bytes
    if (packed.size() < sizeof header) fail_damaged();
    std::memcpy(&header, packed.data(), sizeof header);
    if (header[1] != expected || header[3] != packed.size()) fail_damaged();
  }

  Stream& stream_;
  const TreePlace& place_;
  std::string block_;
};

// Passes over the nodes from the root to the leaves' masks and calls, in the order of the file: background(tree) and
// root_tile(tree, origin), which read what is theirs; tiles<Level>(tree, origin, children, active) of an inner node,
// which passes over or reads its values; leaf(origin, active).
template <typename Visitor>
class TopologyWalk {
 public:
  TopologyWalk(TreeStream& tree, Visitor& visitor, const Context& context)
      : tree_(tree), visitor_(visitor), context_(context) {}

  void run() {
    Stream& stream = tree_.stream();
    if (stream.value<std::int32_t>() != 1) fail_damaged();  // buffers of a leaf
    visitor_.background(tree_);
    const std::uint64_t tiles = stream.value<std::uint32_t>();
    const std::uint64_t children = stream.value<std::uint32_t>();
    std::set<Index> origins;  // a damaged file may repeat one as often as it is long
    const auto origin = [&] {
      const Index at = stream.place();
      constexpr std::int64_t inside = (std::int64_t{1} << Node<2>::total) - 1;
      if (((at[0] | at[1] | at[2]) & inside) != 0 || !origins.insert(at).second) fail_damaged();
      return at;
    };
    for (std::uint64_t i = 0; i < tiles; ++i) {
      context_.throw_if_cancelled();
      visitor_.root_tile(tree_, origin());
    }
    for (std::uint64_t i = 0; i < children; ++i) node<2>(origin());
  }

 private:
  template <int Level>
  void node(const Index& origin) {
    if constexpr (Level == 0) {
      visitor_.leaf(origin, tree_.template mask<0>());
    } else {
      context_.throw_if_cancelled();
      const auto children = tree_.template mask<Level>(), active = tree_.template mask<Level>();
      if (!(children & active).isOff()) fail_damaged();
      visitor_.template tiles<Level>(tree_, origin, children, active);
      for (auto n = children.beginOn(); n; ++n) node<Level - 1>(place_of<Level>(origin, n.pos()));
    }
  }

  TreeStream& tree_;
  Visitor& visitor_;
  const Context& context_;
};

struct Measuring {
  TreeExtent extent;

  void background(TreeStream& tree) { tree.stream().skip(tree.type().bytes); }

  void root_tile(TreeStream& tree, const Index& origin) {
    tree.stream().skip(tree.type().bytes);
    if (tree.stream().template value<char>() != 0) include(origin, Node<2>::total);
  }

  template <int Level>
  void tiles(TreeStream& tree, const Index& origin, const MaskOf<Level>&, const MaskOf<Level>& active) {
    tree.stream().skip(tree.values<Level>(active).bytes);
    for (auto n = active.beginOn(); n; ++n) include(place_of<Level>(origin, n.pos()), Node<Level - 1>::total);
  }

  void leaf(const Index& origin, const MaskOf<0>& active) {
    ++extent.leaves;
    extent.active += active.countOn();
    std::uint64_t all = 0, rows = 0;  // a word a plane: bit 8 y + z
    for (std::uint32_t x = 0; x < 8; ++x) {
      const std::uint64_t word = active.template getWord<std::uint64_t>(x);
      if (word != 0) include_along(0, origin[0] + x, origin[0] + x);
      all |= word;
    }
    if (all == 0) return;
    include_along(1, origin[1] + std::countr_zero(all) / 8, origin[1] + (63 - std::countl_zero(all)) / 8);
    for (int y = 0; y < 8; ++y) rows |= all >> 8 * y & 0xff;
    include_along(2, origin[2] + std::countr_zero(rows), origin[2] + 63 - std::countl_zero(rows));
  }

 private:
  void include_along(std::size_t axis, std::int64_t low, std::int64_t high) {
    extent.min[axis] = std::min(extent.min[axis], low);
    extent.max[axis] = std::max(extent.max[axis], high);
  }
  void include(const Index& origin, int log_size) {
    const std::int64_t size = std::int64_t{1} << log_size;
    for (std::size_t a = 0; a < 3; ++a) include_along(a, origin[a], origin[a] + size - 1);
    extent.active += std::ldexp(1.0, 3 * log_size);
  }
};

// Puts values into dense samples of type T; T is unsigned for bool, of which a damaged file may have any.
template <typename T>
class Filling {
 public:
  Filling(Volume& volume, const Index& first, const Context& context)
      : samples_(reinterpret_cast<T*>(volume.voxels.data())), first_(first), context_(context) {
    for (std::size_t a = 0; a < 3; ++a) dims_[a] = volume.grid.dims[a];
  }

  void background(TreeStream& tree) {
    background_ = clean(tree, tree.stream().template value<T>());
    const std::int64_t slice = dims_[0] * dims_[1];
    for (std::int64_t k = 0; k < dims_[2]; ++k) {
      context_.throw_if_cancelled();
      std::fill_n(samples_ + k * slice, slice, background_);
    }
  }

  void root_tile(TreeStream& tree, const Index& origin) {
    const T value = clean(tree, tree.stream().template value<T>());
    tree.stream().skip(1);
    fill(origin, Node<2>::total, value);
  }

  template <int Level>
  void tiles(TreeStream& tree, const Index& origin, const MaskOf<Level>& children, const MaskOf<Level>& active) {
    read_values<Level>(tree, active);
    for (auto n = children.beginOff(); n; ++n) {
      fill(place_of<Level>(origin, n.pos()), Node<Level - 1>::total, values_[n.pos()]);
    }
  }

  void leaf(const Index& origin, const MaskOf<0>&) { leaves_.push_back(origin); }

  // The leaves' values follow in the order of their nodes.
  void read_leaves(TreeStream& tree) {
    const std::size_t count = leaves_.size();
    for (std::size_t i = 0; i < count; ++i) {
      if (i % 1024 == 0) {
        context_.throw_if_cancelled();
        context_.report("read", 0.2 + 0.8 * static_cast<double>(i) / static_cast<double>(count));
      }
      const auto active = tree.mask<0>();
      if (tree.type().leaf == GridType::Leaf::values) {
        read_values<0>(tree, active);
      } else {
        tree.stream().skip(3 * sizeof(std::int32_t));  // its origin
        const auto bits = tree.type().leaf == GridType::Leaf::bits ? tree.mask<0>() : active;
        values_.assign(MaskOf<0>::SIZE, T{0});
        for (auto n = bits.beginOn(); n; ++n) values_[n.pos()] = T{1};
      }
      put_leaf(leaves_[i]);
    }
  }

 private:
  static T clean(const TreeStream& tree, T value) {
    return tree.type().leaf == GridType::Leaf::values ? value : static_cast<T>(value != T{0});
  }
  static T opposite(const TreeStream& tree, T value) {
    if (tree.type().leaf != GridType::Leaf::values) return static_cast<T>(value == T{0});
    if constexpr (std::is_integral_v<T>) return static_cast<T>(0 - static_cast<std::make_unsigned_t<T>>(value));
    return -value;
  }

  // All values of a node, the inactive ones put back: they are the background, its opposite, or what is said.
  template <int Level>
  void read_values(TreeStream& tree, const MaskOf<Level>& active) {
    using namespace openvdb::io;
    const Values<Level> v = tree.values<Level>(active);
    tree.unpack(v, stored_);
    for (T& value : stored_) value = clean(tree, value);
    if (v.count == MaskOf<Level>::SIZE) {
      values_.swap(stored_);
      return;
    }
    const auto said = [&](std::size_t i) {
      T value;
      std::memcpy(&value, v.inactive[i].data(), sizeof value);
      return clean(tree, value);
    };
    const bool two = v.form == MASK_AND_TWO_INACTIVE_VALS;
    const bool one = v.form == NO_MASK_AND_ONE_INACTIVE_VAL || v.form == MASK_AND_ONE_INACTIVE_VAL;
    const T unselected = one || two                           ? said(0)
                         : v.form == NO_MASK_OR_INACTIVE_VALS ? background_
                                                              : opposite(tree, background_);
    const T selected = two ? said(1) : background_;
    values_.resize(MaskOf<Level>::SIZE);
    std::size_t next = 0;
    for (std::uint32_t n = 0; n < MaskOf<Level>::SIZE; ++n) {
      values_[n] = active.isOn(n) ? stored_[next++] : v.selection.isOn(n) ? selected : unselected;
    }
  }

  void fill(const Index& origin, int log_size, T value) {
    if (value == background_) return;
    Index low, high;
    for (std::size_t a = 0; a < 3; ++a) {
      low[a] = std::max<std::int64_t>(origin[a] - first_[a], 0);
      high[a] = std::min<std::int64_t>(origin[a] - first_[a] + (std::int64_t{1} << log_size), dims_[a]);
      if (low[a] >= high[a]) return;
    }
    for (std::int64_t k = low[2]; k < high[2]; ++k) {
      context_.throw_if_cancelled();
      for (std::int64_t j = low[1]; j < high[1]; ++j) {
        std::fill_n(samples_ + (k * dims_[1] + j) * dims_[0] + low[0], high[0] - low[0], value);
      }
    }
  }

  void put_leaf(const Index& origin) {
    for (std::uint32_t n = 0; n < MaskOf<0>::SIZE; ++n) {
      Index at = place_of<0>(origin, n);
      bool within = true;
      for (std::size_t a = 0; a < 3; ++a) {
        at[a] -= first_[a];
        within = within && at[a] >= 0 && at[a] < dims_[a];
      }
      if (within) samples_[(at[2] * dims_[1] + at[1]) * dims_[0] + at[0]] = values_[n];
    }
  }

  T* samples_;
  Index first_, dims_{};
  const Context& context_;
  T background_{};
  std::vector<T> values_, stored_;
  std::vector<Index> leaves_;
};

template <typename T>
void fill(Volume& volume, const Index& first, TreeStream& tree, const Context& context) {
  Filling<T> filling(volume, first, context);
  TopologyWalk(tree, filling, context).run();
  filling.read_leaves(tree);
}

TreeExtent pass_topology(TreeStream& tree, const Context& context) {
  Measuring measuring;
  TopologyWalk(tree, measuring, context).run();
  return measuring.extent;
}

}  // namespace

TreeExtent measure_tree(Stream& stream, const TreePlace& place, const Context& context) {
  stream.seek(place.position);
  TreeStream tree(stream, place);
  return pass_topology(tree, context);
}

void pass_tree(Stream& stream, const TreePlace& place, const Context& context) {
  stream.seek(place.position);
  TreeStream tree(stream, place);
  const TreeExtent extent = pass_topology(tree, context);
  for (std::uint64_t i = 0; i < extent.leaves; ++i) {
    if (i % 1024 == 0) context.throw_if_cancelled();
    const auto active = tree.mask<0>();
    switch (place.type->leaf) {
      case GridType::Leaf::values: stream.skip(tree.values<0>(active).bytes); break;
      case GridType::Leaf::bits: stream.skip(3 * sizeof(std::int32_t) + MaskOf<0>::SIZE / 8); break;
      case GridType::Leaf::states: stream.skip(3 * sizeof(std::int32_t)); break;
    }
  }
}

void read_tree(Volume& volume, std::array<std::int64_t, 3> first, Stream& stream, const TreePlace& place,
               const Context& context) {
  stream.seek(place.position);
  TreeStream tree(stream, place);
  switch (volume.type) {
    case VoxelType::float32: fill<float>(volume, first, tree, context); break;
    case VoxelType::float64: fill<double>(volume, first, tree, context); break;
    case VoxelType::int32: fill<std::int32_t>(volume, first, tree, context); break;
    case VoxelType::int64: fill<std::int64_t>(volume, first, tree, context); break;
    default: fill<std::uint8_t>(volume, first, tree, context);
  }
  context.report("read", 1);
}

}  // namespace spherule::vdb
